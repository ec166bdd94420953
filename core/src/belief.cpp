#include "tomotactile/belief.hpp"

#include <cmath>
#include <numeric>

namespace tomotactile {
namespace {

// m/s: the same of a contact that rests: friction. With 0.3, 307 instead of 277 of 13,472 rows of taps beside one had a
// ghost on 4 x 4 electrodes
constexpr double kHeld = 0.03;
constexpr int kRested = 32;           // rows: what has been there for so many, and is slow, rests
constexpr double kForgetting = 60.0;  // s: a minute of rows tells of the sensor, as many touches as a hand makes in it
constexpr double kPressing = 0.08;    // of ln c in a millisecond's root: 10 /s over a frame of 64 rows as `prior.RATES`

}  // namespace

Belief Belief::untouched(const Vector& deviation) {
  Belief out;
  out.mean = Vector::Zero(deviation.size());
  out.covariance = deviation.cwiseAbs2().asDiagonal();
  out.sizes.resize(2, 0);
  return out;
}

void Belief::check() const {
  const Index k = count(), all = mean.size();
  if (all < kState * k || covariance.rows() != all || covariance.cols() != all || Index(numbers.size()) != k ||
      Index(rows.size()) != k || Index(begun.size()) != k)
    throw BadInput("what is believed does not fit the contacts and the sensor");
}

Discs Belief::contacts(const Vector& of) const {
  Discs out(4, count());
  for (Index i = 0; i < count(); ++i) out.col(i) << of.segment<2>(kState * i), of[kState * i + 4], sizes(0, i);
  return out;
}

Belief Belief::later(double lasts, const Vector& deviation, double faded) const {
  Belief out = *this;
  if (!count() || !(lasts > 0)) return out;
  const Index contacts = kState * count(), sensor = mean.size() - contacts;
  if (deviation.size() != sensor) throw BadInput("deviations do not fit the sensor");
  for (Index i = 0; i < count(); ++i) {
    const Index at = kState * i;
    out.mean.segment<2>(at) += lasts * out.mean.segment<2>(at + 2);
    out.covariance.middleRows<2>(at) += lasts * out.covariance.middleRows<2>(at + 2);
    out.covariance.middleCols<2>(at) += lasts * out.covariance.middleCols<2>(at + 2);
    const bool rests = rows[i] >= kRested && mean.segment<2>(at + 2).squaredNorm() < kSlow * kSlow;
    const double q = std::pow(rests ? kHeld : kEnduring, 2) / kWithin * lasts;
    for (Index d = at; d < at + 2; ++d) {
      out.covariance(d, d) += q * lasts * lasts / 3;
      out.covariance(d, d + 2) += q * lasts / 2, out.covariance(d + 2, d) += q * lasts / 2;
      out.covariance(d + 2, d + 2) += q;
    }
    out.covariance(at + 4, at + 4) += kPressing * kPressing * lasts / 1e-3;
  }
  if (faded > 0) {
    const double kept = std::exp(-faded / kForgetting);
    out.mean.tail(sensor) *= kept;
    out.covariance.bottomRows(sensor) *= kept;
    out.covariance.rightCols(sensor) *= kept;
    out.covariance.diagonal().tail(sensor) += (1 - kept * kept) * deviation.cwiseAbs2();
  }
  return out;
}

Belief Belief::loosened(const Eigen::Matrix<double, kState, 1>& variances) const {
  Belief out = *this;
  out.covariance.diagonal().head(kState * count()) += variances.replicate(count(), 1);
  return out;
}

Belief Belief::of_sensor() const {
  const Index own = mean.size() - kState * count();
  Belief out;
  out.mean = mean.tail(own), out.covariance = covariance.bottomRightCorner(own, own);
  out.sizes.resize(2, 0);
  return out;
}

Belief Belief::without(Index which) const {
  std::vector<int> kept(mean.size());
  std::iota(kept.begin(), kept.end(), 0);
  kept.erase(kept.begin() + kState * which, kept.begin() + kState * (which + 1));
  Belief out;
  out.mean = mean(kept), out.covariance = covariance(kept, kept);
  out.sizes.resize(2, count() - 1);
  out.sizes << sizes.leftCols(which), sizes.rightCols(count() - 1 - which);
  out.numbers = numbers, out.rows = rows, out.begun = begun;
  out.numbers.erase(out.numbers.begin() + which);
  out.rows.erase(out.rows.begin() + which);
  out.begun.erase(out.begun.begin() + which);
  return out;
}

Belief Belief::with_contact(const Eigen::Matrix<double, kState, 1>& added, const Eigen::Matrix<double, kState, kState>& own,
                            const Eigen::Vector2d& size, int number, double since, int shown) const {
  const Index at = kState * count(), sensor = mean.size() - at, all = mean.size() + kState;
  Belief out;
  out.mean.resize(all), out.mean << mean.head(at), added, mean.tail(sensor);
  out.covariance = Matrix::Zero(all, all);
  out.covariance.topLeftCorner(at, at) = covariance.topLeftCorner(at, at);
  out.covariance.topRightCorner(at, sensor) = covariance.topRightCorner(at, sensor);
  out.covariance.bottomLeftCorner(sensor, at) = covariance.bottomLeftCorner(sensor, at);
  out.covariance.bottomRightCorner(sensor, sensor) = covariance.bottomRightCorner(sensor, sensor);
  out.covariance.block<kState, kState>(at, at) = own;
  out.sizes.resize(2, count() + 1), out.sizes << sizes, size;
  out.numbers = numbers, out.rows = rows, out.begun = begun;
  out.numbers.push_back(number), out.rows.push_back(shown), out.begun.push_back(since);
  return out;
}

Belief Belief::unlearned(const Vector& deviation) const {
  Belief out = untouched(deviation);
  for (Index i = 0; i < count(); ++i)
    out = out.with_contact(mean.segment<kState>(kState * i), covariance.block<kState, kState>(kState * i, kState * i), sizes.col(i),
                           numbers[i], begun[i]);
  out.rows = rows;
  return out;
}

}  // namespace tomotactile
