#include "tomotactile/induced.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

namespace tomotactile {
namespace {

constexpr double kBegin = 0.8, kEnd = 1.3;  // spacings: induced charges fade between these
constexpr double kSeries = 0.15;            // |z|^2: of larger ones the logarithm is taken as it is
constexpr double kExact = 1e-6;             // how much of the sum the terms left away are

}  // namespace

double InducedCharges::squared(double x, double y) const {
  const double rim = kRim * radius;
  return std::max(x * x + y * y, rim * rim);
}

double InducedCharges::nearness(double squared) const {
  const double far = std::min(std::max((std::sqrt(squared) / pitch - kBegin) / (kEnd - kBegin), 0.0), 1.0);
  return 1 - far * far * (3 - 2 * far);
}

double InducedCharges::nearness_slope(double squared) const {
  const double distance = std::sqrt(squared);
  const double far = std::min(std::max((distance / pitch - kBegin) / (kEnd - kBegin), 0.0), 1.0);
  return -3 * far * (1 - far) / (distance * pitch * (kEnd - kBegin));
}

Charges::Charges(const InducedCharges& electrodes, const Points& places) : electrodes_(&electrodes) {
  const Index count = places.cols();
  const double reach = kEnd * electrodes.pitch * kEnd * electrodes.pitch, radius = electrodes.radius;
  struct Seen {
    Index electrode;
    double least;
  };
  std::vector<Seen> far;
  double rest = 0;
  for (Index e = 0; e < electrodes.centres.cols(); ++e) {
    double least = std::numeric_limits<double>::infinity();
    for (Index p = 0; p < count; ++p)
      least = std::min(least, electrodes.squared(places(0, p) - electrodes.centres(0, e),
                                                 places(1, p) - electrodes.centres(1, e)));
    if (!(least < reach)) continue;
    const double largest = radius * radius / least;
    if (largest <= kSeries) {
      far.push_back({e, least});
      rest = std::max(rest, largest);
      continue;
    }
    Close close;
    close.weight.resize(count), close.share.resize(count), close.fading.resize(count);
    close.apart.resize(2, count), close.image.resize(2, count);
    for (Index p = 0; p < count; ++p) {
      const Eigen::Vector2d apart = places.col(p) - electrodes.centres.col(e);
      const double squared = electrodes.squared(apart.x(), apart.y());
      close.weight[p] = electrodes.nearness(squared);
      close.fading[p] = electrodes.nearness_slope(squared);
      close.share[p] = radius * radius / squared;
      close.apart.col(p) = apart;
      close.image.col(p) = close.share[p] * apart;
    }
    close_.push_back(std::move(close));
  }
  if (rest == 0) rest = kExact;
  const int terms = std::max(int(std::ceil(std::log(kExact) / std::log(rest))), 1);
  columns_.resize(2 * terms * far.size(), count);
  along_x_.resize(columns_.rows(), count), along_y_.resize(columns_.rows(), count);
  for (std::size_t m = 0; m < far.size(); ++m) {
    for (Index p = 0; p < count; ++p) {
      const Eigen::Vector2d apart = places.col(p) - electrodes.centres.col(far[m].electrode);
      const double squared = electrodes.squared(apart.x(), apart.y());
      const double weight = electrodes.nearness(squared), fades = 2 * electrodes.nearness_slope(squared);
      const std::complex<double> z(apart.x() * radius / squared, apart.y() * radius / squared);
      std::complex<double> power = z;
      for (int k = 1; k <= terms; ++k) {
        const double root = std::sqrt(2 * electrodes.scale / k);
        const std::complex<double> next = power * z, moves = weight * (k / radius) * next;
        const std::complex<double> value = root * weight * power;
        const std::complex<double> by_x = root * (fades * apart.x() * power - moves);
        const std::complex<double> by_y =
            root * (fades * apart.y() * power + std::complex<double>(0, 1) * moves);
        const Index row = 2 * (terms * Index(m) + k - 1);
        columns_(row, p) = value.real(), columns_(row + 1, p) = value.imag();
        along_x_(row, p) = by_x.real(), along_x_(row + 1, p) = by_x.imag();
        along_y_(row, p) = by_y.real(), along_y_(row + 1, p) = by_y.imag();
        power = next;
      }
    }
  }
}

void Charges::add_among(const std::vector<int>& chosen, Matrix& out) const {
  if (columns_.rows()) {
    const Matrix columns = columns_(Eigen::all, chosen);
    out.noalias() -= columns.transpose() * columns;
  }
  const double turned = 2 / (electrodes_->radius * electrodes_->radius), scale = electrodes_->scale;
  for (const Close& close : close_) {
    for (std::size_t j = 0; j < chosen.size(); ++j) {
      const int q = chosen[j];
      if (close.weight[q] == 0) continue;
      for (std::size_t i = 0; i <= j; ++i) {
        const int p = chosen[i];
        if (close.weight[p] == 0) continue;
        const double part = close.share[p] * close.share[q] - turned * close.image.col(p).dot(close.image.col(q));
        const double value = scale * close.weight[p] * close.weight[q] * std::log1p(std::max(part, kRim - 2));
        out(i, j) += value;
        if (i != j) out(j, i) += value;
      }
    }
  }
}

void Charges::add_slope(Index first, Index count, const std::vector<int>& others, Matrix& along_x,
                        Matrix& along_y) const {
  if (columns_.rows()) {
    const Matrix columns = columns_(Eigen::all, others);
    along_x.noalias() -= along_x_.middleCols(first, count).transpose() * columns;
    along_y.noalias() -= along_y_.middleCols(first, count).transpose() * columns;
  }
  const double turned = 2 / (electrodes_->radius * electrodes_->radius), scale = electrodes_->scale;
  for (const Close& close : close_) {
    for (std::size_t j = 0; j < others.size(); ++j) {
      const int q = others[j];
      if (close.weight[q] == 0) continue;
      for (Index i = 0; i < count; ++i) {
        const Index p = first + i;
        if (close.weight[p] == 0) continue;
        const double by_share = close.share[q] - turned * close.apart.col(p).dot(close.image.col(q));
        const double part = close.share[p] * by_share, kept = std::max(part, kRim - 2);
        const double rate = part > kRim - 2 ? close.weight[p] * close.weight[q] / (1 + kept) : 0.0;
        const double fades = close.fading[p] * close.weight[q] * std::log1p(kept);
        const double radial = 2 * fades - rate * by_share * turned * close.share[p] * close.share[p];
        const double turn = turned * close.share[p] * rate;
        along_x(i, j) += scale * (radial * close.apart(0, p) - turn * close.image(0, q));
        along_y(i, j) += scale * (radial * close.apart(1, p) - turn * close.image(1, q));
      }
    }
  }
}

}  // namespace tomotactile
