# A simulated sensor and its live picture, from nothing:
#
#     docker build -t tomotactile . && docker run --rm -it tomotactile
#
# Another command, for example a shell: docker run --rm -it tomotactile scripts/setup bash
FROM python:3.12-slim-bookworm

RUN apt-get update \
  && apt-get install --yes --no-install-recommends build-essential cmake \
  && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home user
USER user
RUN mkdir /home/user/tomotactile_ros
WORKDIR /home/user/tomotactile_ros
COPY --chown=user . .
RUN make setup
CMD ["make", "run", "DURATION=60"]
