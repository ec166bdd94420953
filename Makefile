# Everything works from a fresh clone: the setup script makes what is missing, then runs the command.
DURATION ?= 20
PYTEST_ARGS ?= --durations 20
SETUP := scripts/setup
PROGRAMS := install/tomotactile_ros/lib/tomotactile_ros

.PHONY: help setup run play view check format test bench paper docs fuzz sanitize faults protocol pictures lock clean

help:
	@echo "make run      a simulated sensor, its reconstruction and a live picture (DURATION=20 LAYOUT= SCENE= PROFILE=fast)"
	@echo "make play     a simulated sheet in the browser, to be pressed with the pointer (LAYOUT= PLAY_ARGS=)"
	@echo "make view     a sensor or a recording in the browser (VIEW_ARGS='--recording frames.npz')"
	@echo "make check    what CI looks at before the tests"
	@echo "make format   mend the style of Python files"
	@echo "make test     all tests, and which take longest (PYTEST_ARGS=)"
	@echo "make bench    speed, accuracy and stability as a table and out/bench.json (BENCH_ARGS=)"
	@echo "make paper    figures and numbers of the paper computed again, in out/paper (PAPER_ARGS=)"
	@echo "make docs     pages of the Python library, in build/api/index.html"
	@echo "make fuzz     random bytes against the wire protocol"
	@echo "make sanitize the compiled core under sanitizers, with random arrays"
	@echo "make faults   everything that can go wrong with a sensor, on purpose (FAULTS_ARGS=)"
	@echo "make protocol constants and tables of the wire protocol, from docs/protocol.yaml"
	@echo "make pictures pictures of README and docs, again (PICTURES='play.png run.gif')"
	@echo "make setup    only set up and build; scripts/setup COMMAND runs any command there"
	@echo "make lock     pin all packages anew, with hashes, in scripts/requirements.lock"
	@echo "make clean    remove everything that was made"

setup:
	@$(SETUP)

run:
	@$(SETUP) $(PROGRAMS)/live --duration $(DURATION) \
		$(if $(LAYOUT),--layout '$(LAYOUT)') $(if $(SCENE),--scene '$(SCENE)') $(if $(PROFILE),--profile '$(PROFILE)')

play:
	@$(SETUP) tomotactile play $(if $(LAYOUT),--layout '$(LAYOUT)') $(PLAY_ARGS)

view:
	@$(SETUP) tomotactile view $(if $(LAYOUT),--layout '$(LAYOUT)') $(VIEW_ARGS)

# Where pytest-xdist is installed on all cores, the tests of a file one after the other. There is one process
# more than cores: tests of nodes wait half of their time. What is compiled of Python is kept: without, each of
# these processes compiles all tests.
test:
	@$(SETUP) env -u PYTHONDONTWRITEBYTECODE sh -c 'python3 -c "import xdist" 2>/dev/null && \
		cores="-n $$(($$(env -u OMP_NUM_THREADS nproc) + 1)) --dist loadfile"; \
		exec python3 -m pytest $$cores "$$@"' pytest $(PYTEST_ARGS)

check: # style, types, spelling, pages of the interface
	@scripts/check

format:
	@scripts/check fix

bench:
	@$(SETUP) tomotactile bench $(BENCH_ARGS)

paper:
	@$(SETUP) tomotactile paper $(PAPER_ARGS)

docs:
	@scripts/check api

fuzz:
	@$(SETUP) python3 benchmark/fuzz_protocol.py

sanitize:
	@scripts/sanitize

protocol:
	@$(SETUP) scripts/protocol

faults:
	@$(SETUP) python3 -u benchmark/faults.py $(FAULTS_ARGS)

pictures:
	@$(SETUP) scripts/pictures $(PICTURES)

lock:
	@scripts/lock

clean:
	rm -rf .venv build install log out
