#include "tomotactile/induced.hpp"

#include <cmath>
#include <utility>

namespace tomotactile {
namespace {

// |z| of places beside an electrode: the next term between its rim and farther ones is at most 5 ohm of 1e4 ohm a square
constexpr double kClose = 0.08;
constexpr double kSame = 1e-6;  // radii: what is nearer to each other is in the same place

// Calls `seen(x, y, to_x, to_y)` with the ways from all centres to a place and to its images, and the signs with which
// these follow it.
template <class Seen>
void for_images(const InducedCharges& e, const Eigen::Vector2d& place, Seen seen) {
  const int images = e.size.x() > 0 ? 3 : 1;
  const double sign[3] = {1, -1, -1}, beside[3] = {0, e.size.x(), -e.size.x()}, above[3] = {0, e.size.y(), -e.size.y()};
  std::array<Eigen::ArrayXd, 3> x, y;
  for (int i = 0; i < images; ++i) {
    x[i] = sign[i] * place.x() + beside[i] - e.centres.row(0).transpose().array();
    y[i] = sign[i] * place.y() + above[i] - e.centres.row(1).transpose().array();
  }
  for (int i = 0; i < images; ++i)
    for (int j = 0; j < images; ++j) seen(x[i], y[j], sign[i], sign[j]);
}

}  // namespace

InducedCharges::InducedCharges(Points at, double wide, double resistance, const Eigen::Vector2d& mirrored)
    : centres(std::move(at)), radius(wide), scale(resistance / (4 * kPi)), size(mirrored),
      own_images(centres.cols()), counted(centres.cols()), weights(2 * centres.cols()) {
  if (!(radius > 0 && scale > 0)) throw BadInput("induced charges: radius and resistance must be above 0");
  for (Index e = 0; e < centres.cols(); ++e) {
    for_images(*this, centres.col(e), [&](const auto& x, const auto& y, double to_x, double to_y) {
      if (std::hypot(x[e], y[e]) < kSame * radius) own_images[e].emplace_back(to_x, to_y);
    });
    counted[e] = double(own_images[e].size());
  }
  weights << 2 * scale * counted.cwiseInverse(), 2 * scale * counted.cwiseInverse();
}

Matrix InducedCharges::dipoles(const Points& places) const {
  const Index count = centres.cols();
  const double rim = kRim * radius;
  Matrix out = Matrix::Zero(2 * count, places.cols());
  for (Index p = 0; p < places.cols(); ++p) {
    auto re = out.col(p).head(count).array(), im = out.col(p).tail(count).array();
    for_images(*this, places.col(p), [&](const auto& x, const auto& y, double, double) {
      const Eigen::ArrayXd over = radius / (x * x + y * y).max(rim * rim);
      re += x * over, im += y * over;
    });
  }
  return out;
}

std::array<Matrix, 2> InducedCharges::dipole_slopes(const Points& places) const {
  const Index count = centres.cols();
  const double rim = kRim * radius;
  std::array<Matrix, 2> out{Matrix::Zero(2 * count, places.cols()), Matrix::Zero(2 * count, places.cols())};
  for (Index p = 0; p < places.cols(); ++p) {
    auto re_x = out[0].col(p).head(count).array(), im_x = out[0].col(p).tail(count).array();
    auto re_y = out[1].col(p).head(count).array(), im_y = out[1].col(p).tail(count).array();
    for_images(*this, places.col(p), [&](const auto& x, const auto& y, double to_x, double to_y) {
      const Eigen::ArrayXd over = 1 / (x * x + y * y).max(rim * rim);
      const Eigen::ArrayXd straight = radius * over * over * (y * y - x * x), turned = -2 * radius * over * over * x * y;
      re_x += to_x * straight, im_x += to_x * turned;
      re_y += to_y * turned, im_y -= to_y * straight;
    });
  }
  return out;
}

Matrix InducedCharges::fed(const Points& electrodes) const {
  return (-weights).asDiagonal() * dipoles(electrodes);
}

Vector InducedCharges::own(const Points& places) const {
  Vector out(places.cols());
  for (Index p = 0; p < places.cols(); ++p) {
    Matrix each = Matrix::Zero(1, 1);
    Charges(*this, places.col(p)).add_between(0, 1, {0}, each);
    out[p] = each(0, 0);
  }
  return out;
}

Charges::Charges(const InducedCharges& electrodes, const Points& places)
    : electrodes_(&electrodes), dipoles_(electrodes.dipoles(places)) {
  const double rim = kRim * electrodes.radius;
  for (Index e = 0; e < electrodes.centres.cols(); ++e) {
    const Points apart = places.colwise() - electrodes.centres.col(e);
    const Eigen::ArrayXd size = electrodes.radius / apart.colwise().squaredNorm().transpose().array().max(rim * rim).sqrt();
    Close close;
    close.number.assign(places.cols(), -1);
    std::vector<int> there;
    for (Index p = 0; p < places.cols(); ++p)
      if (size[p] > kClose) close.number[p] = int(there.size()), there.push_back(int(p));
    if (there.empty()) continue;
    close.z = apart(Eigen::all, there) * (size(there).square() / electrodes.radius).matrix().asDiagonal();
    for (const Eigen::Vector2d& sign : electrodes.own_images[e]) close.seen.push_back(sign.asDiagonal() * close.z);
    close_.push_back(std::move(close));
  }
}

// Those of places `first` ... `first + count` and of `others` that are near an electrode.
Charges::Pairs Charges::beside(const Close& close, Index first, Index count, const std::vector<int>& others) {
  Pairs out;
  std::vector<int> mine;
  for (Index i = 0; i < count; ++i)
    if (close.number[first + i] >= 0) out.here.push_back(int(i)), mine.push_back(close.number[first + i]);
  for (std::size_t j = 0; j < others.size(); ++j)
    if (close.number[others[j]] >= 0) out.on.push_back(int(j)), out.theirs.push_back(close.number[others[j]]);
  out.z = close.z(Eigen::all, mine);
  return out;
}

void Charges::add_between(Index first, Index count, const std::vector<int>& others, Matrix& out) const {
  out.noalias() -= (electrodes_->weights.asDiagonal() * dipoles_.middleCols(first, count)).transpose() * dipoles_(Eigen::all, others);
  for (const Close& close : close_) {
    const Pairs pairs = beside(close, first, count, others);
    if (pairs.here.empty() || pairs.on.empty()) continue;
    const Vector square = pairs.z.colwise().squaredNorm().transpose();
    for (const Points& images : close.seen) {
      const Points theirs = images(Eigen::all, pairs.theirs);
      const Eigen::ArrayXXd re = (pairs.z.transpose() * theirs).array();
      const Eigen::ArrayXXd size = (square * theirs.colwise().squaredNorm()).array();  // |1 - x|^2 is this, 1 and -2 re
      const Eigen::ArrayXXd rest = (1 + (size - 2 * re)).max(kRim - 1).log() + 2 * re;
      for (std::size_t j = 0; j < pairs.on.size(); ++j)
        for (std::size_t i = 0; i < pairs.here.size(); ++i) out(pairs.here[i], pairs.on[j]) += electrodes_->scale * rest(i, j);
    }
  }
}

void Charges::add_slope(Index first, Index count, const std::vector<int>& others, const std::array<Matrix, 2>& steep,
                        Matrix& along_x, Matrix& along_y) const {
  const Matrix theirs = electrodes_->weights.asDiagonal() * dipoles_(Eigen::all, others);
  along_x.noalias() -= steep[0].transpose() * theirs;
  along_y.noalias() -= steep[1].transpose() * theirs;
  for (const Close& close : close_) {
    const Pairs pairs = beside(close, first, count, others);
    if (pairs.here.empty() || pairs.on.empty()) continue;
    const Eigen::ArrayXd square = pairs.z.colwise().squaredNorm().transpose();
    const Eigen::ArrayXd x = pairs.z.row(0).transpose(), y = pairs.z.row(1).transpose();
    const double rate = electrodes_->scale * 2 / electrodes_->radius;
    for (const Points& images : close.seen)
      for (std::size_t j = 0; j < pairs.on.size(); ++j) {
        const Eigen::Vector2d other = images.col(pairs.theirs[j]);
        const Eigen::ArrayXd re = x * other.x() + y * other.y(), size = square * other.squaredNorm(), far = 1 + (size - 2 * re);
        const Eigen::ArrayXd over = (far > kRim - 1).select(1 / far, 0.0);
        // z moves by (|z|^2 - 2 z z^T) / R with the place
        const Eigen::ArrayXd straight = rate * (1 - over) * square, back = rate * (2 * (1 - over) * re + over * size);
        for (std::size_t i = 0; i < pairs.here.size(); ++i) {
          along_x(pairs.here[i], pairs.on[j]) += straight[i] * other.x() - back[i] * x[i];
          along_y(pairs.here[i], pairs.on[j]) += straight[i] * other.y() - back[i] * y[i];
        }
      }
  }
}

}  // namespace tomotactile
