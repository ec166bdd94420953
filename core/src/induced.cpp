#include "tomotactile/induced.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>

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
  std::vector<Index> seen;  // of those in `far_`
  Index rows = 0;
  for (Index e = 0; e < electrodes.centres.cols(); ++e) {
    double least = std::numeric_limits<double>::infinity();
    for (Index p = 0; p < count; ++p)
      least = std::min(least, electrodes.squared(places(0, p) - electrodes.centres(0, e),
                                                 places(1, p) - electrodes.centres(1, e)));
    if (!(least < reach)) continue;
    const double largest = radius * radius / least;
    if (largest <= kSeries) {
      const int terms = std::max(int(std::ceil(std::log(kExact) / std::log(std::max(largest, kExact)))), 1);
      far_.push_back({rows, 2 * terms, std::vector<bool>(count)});
      seen.push_back(e);
      rows += 2 * terms;
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
  columns_ = along_x_ = along_y_ = Matrix::Zero(rows, count);
  for (std::size_t which = 0; which < far_.size(); ++which) {
    Far& far = far_[which];
    for (Index p = 0; p < count; ++p) {
      const Eigen::Vector2d apart = places.col(p) - electrodes.centres.col(seen[which]);
      const double squared = electrodes.squared(apart.x(), apart.y());
      const double weight = electrodes.nearness(squared), fades = 2 * electrodes.nearness_slope(squared);
      if (weight == 0) continue;
      far.near[p] = true;
      const std::complex<double> z(apart.x() * radius / squared, apart.y() * radius / squared);
      std::complex<double> power = z;
      for (int k = 1; 2 * k <= far.count; ++k) {
        const double root = std::sqrt(2 * electrodes.scale / k);
        const std::complex<double> next = power * z, moves = weight * (k / radius) * next;
        const std::complex<double> value = root * weight * power;
        const std::complex<double> by_x = root * (fades * apart.x() * power - moves);
        const std::complex<double> by_y =
            root * (fades * apart.y() * power + std::complex<double>(0, 1) * moves);
        const Index row = far.first + 2 * (k - 1);
        columns_(row, p) = value.real(), columns_(row + 1, p) = value.imag();
        along_x_(row, p) = by_x.real(), along_x_(row + 1, p) = by_x.imag();
        along_y_(row, p) = by_y.real(), along_y_(row + 1, p) = by_y.imag();
        power = next;
      }
    }
  }
}

bool Charges::Far::reaches(Index place, Index places) const {
  return std::find(near.begin() + place, near.begin() + place + places, true) != near.begin() + place + places;
}

// Which of `chosen` are near a close electrode.
std::vector<int> Charges::there(const Close& close, const std::vector<int>& chosen) {
  std::vector<int> out;
  for (std::size_t i = 0; i < chosen.size(); ++i)
    if (close.weight[chosen[i]] != 0) out.push_back(int(i));
  return out;
}

void Charges::add_between(Index first, Index count, const std::vector<int>& others, Matrix& out) const {
  for (const Far& far : far_)
    if (far.reaches(first, count)) {
      const auto rows = columns_.middleRows(far.first, far.count);
      out.noalias() -= rows.middleCols(first, count).transpose() * Matrix(rows(Eigen::all, others));
    }
  const double turned = 2 / (electrodes_->radius * electrodes_->radius), scale = electrodes_->scale;
  std::vector<int> own(count);
  std::iota(own.begin(), own.end(), int(first));
  for (const Close& close : close_) {
    const std::vector<int> here = there(close, own), on = there(close, others);
    if (here.empty() || on.empty()) continue;
    std::vector<int> mine, theirs;
    for (int i : here) mine.push_back(own[i]);
    for (int j : on) theirs.push_back(others[j]);
    const Vector share = close.share(mine).matrix(), other = close.share(theirs).matrix();
    const Vector weight = close.weight(mine).matrix(), other_weight = close.weight(theirs).matrix();
    const Points image = close.image(Eigen::all, mine), other_image = close.image(Eigen::all, theirs);
    Eigen::ArrayXXd part = share * other.transpose() - turned * (image.transpose() * other_image);
    part = part.max(kRim - 2).log1p();
    part *= scale * (weight * other_weight.transpose()).array();
    for (std::size_t j = 0; j < on.size(); ++j)
      for (std::size_t i = 0; i < here.size(); ++i) out(here[i], on[j]) += part(i, j);
  }
}

void Charges::add_slope(Index first, Index count, const std::vector<int>& others, Matrix& along_x,
                        Matrix& along_y) const {
  for (const Far& far : far_)
    if (far.reaches(first, count)) {
      const Matrix columns = columns_.middleRows(far.first, far.count)(Eigen::all, others);
      along_x.noalias() -= along_x_.block(far.first, first, far.count, count).transpose() * columns;
      along_y.noalias() -= along_y_.block(far.first, first, far.count, count).transpose() * columns;
    }
  const double turned = 2 / (electrodes_->radius * electrodes_->radius), scale = electrodes_->scale;
  for (const Close& close : close_) {
    const std::vector<int> on = there(close, others);
    if (on.empty()) continue;
    std::vector<int> theirs;
    for (int j : on) theirs.push_back(others[j]);
    const Eigen::ArrayXd share = close.share.segment(first, count), fading = close.fading.segment(first, count);
    const Eigen::ArrayXd weight = close.weight.segment(first, count);
    const Eigen::ArrayXd x = close.apart.row(0).segment(first, count).transpose(), y = close.apart.row(1).segment(first, count).transpose();
    const bool fades = (fading != 0).any();
    Eigen::ArrayXd by_share, part, kept, rate, radial;
    for (std::size_t j = 0; j < on.size(); ++j) {
      const int other = theirs[j];
      const double image_x = close.image(0, other), image_y = close.image(1, other), other_weight = close.weight[other];
      by_share = close.share[other] - turned * (image_x * x + image_y * y);
      part = by_share * share, kept = part.max(kRim - 2);
      rate = (part > kRim - 2).select(other_weight * weight / (1 + kept), 0.0);
      radial = -turned * rate * by_share * share.square();
      if (fades) radial += (fading != 0).select(2 * other_weight * fading * kept.log1p(), 0.0);
      rate *= turned * share;
      along_x.col(on[j]).array() += scale * (radial * x - image_x * rate);
      along_y.col(on[j]).array() += scale * (radial * y - image_y * rate);
    }
  }
}

}  // namespace tomotactile
