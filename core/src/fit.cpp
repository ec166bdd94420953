#include "tomotactile/fit.hpp"

#include <cmath>

namespace tomotactile {
namespace {

constexpr double kAnyStrength = 1e-2;  // inverse variance of ln c: a tenfold change is nothing unusual

double chi_squared_of(const Matrix& misfit, const Matrix& weights) { return (weights.array() * misfit.array().square()).sum(); }

}  // namespace

Rows::Rows(Matrix read, Matrix weigh, std::vector<int> ground, Vector at)
    : readings(std::move(read)), weights(std::move(weigh)), grounded(std::move(ground)), times(std::move(at)) {
  if (readings.rows() != weights.rows() || readings.cols() != weights.cols() || Index(grounded.size()) != readings.cols())
    throw BadInput("readings, weights and grounded electrodes differ in number");
  if (times.size() && times.size() != readings.cols()) throw BadInput("times are not given for each row");
  if (!readings.allFinite() || !weights.allFinite() || (weights.array() < 0).any())
    throw BadInput("readings and weights must be finite, weights 0 or more");
  if (times.size() && !times.allFinite()) throw BadInput("times must be finite");
  count = (weights.array() != 0).count();
}

bool Rows::same(const Rows& other) const {
  return this == &other || (grounded == other.grounded && weights.rows() == other.weights.rows() && weights == other.weights);
}

Prior::Prior(double radius_, double spread_, double stretch_, const Eigen::Vector3d& rates_, Vector mean_, Vector deviation_,
             const Matrix& inverse, Index modes_)
    : radius(radius_), spread(spread_), stretch(stretch_), rates(rates_), mean(std::move(mean_)),
      deviation(std::move(deviation_)), joint(inverse.size()), modes(modes_) {
  const Index size = mean.size();
  if (deviation.size() != size || (joint && (inverse.rows() != size || inverse.cols() != size)) || modes > size)
    throw BadInput("means, deviations and inverse covariance of the sensor differ in size");
  if (!(radius > 0 && spread > 0 && stretch > 0 && rates.minCoeff() > 0 && (deviation.array() > 0).all()))
    throw BadInput("radius and deviations that are expected must be above 0");
  if (joint) {
    precision = inverse.sparseView();
    const Index n = (size - modes) / kKinds, last = modes + 2 * n;
    for (Index column = modes; column < last; ++column)
      for (Eigen::SparseMatrix<double>::InnerIterator it(precision, column); it; ++it)
        if (it.row() >= modes && it.row() < last && (it.row() - modes) % n != (column - modes) % n) apart_in_channels = false;
  } else {
    precision.resize(size, size);
    precision.reserve(Eigen::VectorXi::Ones(size));
    for (Index i = 0; i < size; ++i) precision.insert(i, i) = 1 / (deviation[i] * deviation[i]);
    precision.makeCompressed();
  }
}

Vector Prior::apart(const Unknowns& u) const {
  Vector out(mean.size());
  out << u.sheet, u.gain, u.offset, u.resistance, u.aside.col(0), u.aside.col(1);
  return out - mean;
}

bool Prior::same_sensor(const Prior& other) const {
  if (this == &other) return true;
  if (joint != other.joint || deviation.size() != other.deviation.size()) return false;
  if (!joint) return deviation == other.deviation;
  if (precision.nonZeros() != other.precision.nonZeros()) return false;
  const Index size = precision.nonZeros();
  return Eigen::Map<const Vector>(precision.valuePtr(), size) == Eigen::Map<const Vector>(other.precision.valuePtr(), size);
}

Fit::Fit(std::shared_ptr<const Sheet> on, Unknowns at, std::shared_ptr<const Rows> read, std::shared_ptr<const Prior> expected,
         std::shared_ptr<const Prediction> known)
    : sheet(std::move(on)), unknowns(std::move(at)), rows(std::move(read)), prior(std::move(expected)),
      prediction(std::move(known)) {
  if (rows->readings.rows() != sheet->count()) throw BadInput("rows have another number of electrodes than the sheet");
  if (prior->mean.size() != sheet->modes() + kKinds * sheet->count() || prior->modes != sheet->modes())
    throw BadInput("what is expected of the sensor does not fit the sheet");
  unknowns.check(*sheet);
  if (unknowns.is_moving() && !rows->times.size()) throw BadInput("contacts move only in rows that have times");
  if (prediction && (prediction->readings.cols() != rows->readings.cols() || prediction->rows != rows->grounded))
    throw BadInput("what is predicted is of other rows");
  if (!prediction) prediction = std::make_shared<Prediction>(sheet, unknowns, rows->grounded, rows->times);
  misfit = rows->readings - prediction->readings;
  chi_squared = chi_squared_of(misfit, rows->weights);
  cost = chi_squared + of_sensor();
  const Vector strengths = unknowns.of_cells();
  cost += strengths.dot(unknowns.bond * strengths);
  const auto contacts = unknowns.contacts.leftCols(unknowns.alone());
  cost += ((contacts.row(kRadius).array() - std::log(prior->radius)) / prior->spread).square().sum();
  cost += contacts.bottomRows<2>().squaredNorm() / (prior->stretch * prior->stretch);
  cost += (prior->rates.cwiseInverse().asDiagonal() * unknowns.rates).squaredNorm();
}

Fit Fit::with(Unknowns other) const {
  if (unknowns.is_moving() || other.is_moving() || !unknowns.contacts.cols() || !other.contacts.cols())
    return Fit(sheet, std::move(other), rows, prior);
  other.check(*sheet);
  auto touches = prediction->middle().touches->with(other.sheet, other.contacts, other.across, other.bond.rows());
  auto at = std::make_shared<Prediction>(sheet, other, rows->grounded, Vector(), std::move(touches));
  return Fit(sheet, std::move(other), rows, prior, std::move(at));
}

Fit Fit::weighed(std::shared_ptr<const Rows> other) const {
  Fit out = *this;
  out.rows = std::move(other);
  out.chi_squared = chi_squared_of(misfit, out.rows->weights);
  out.cost = cost - chi_squared + out.chi_squared;
  return out;
}

double Fit::doubt() const { return 1 + std::max(chi_squared - double(rows->count), 0.0) / double(sheet->count()); }

double Fit::of_sensor() const {
  const Vector apart = prior->apart(unknowns);
  return apart.dot(prior->pull(apart));
}

Slopes Fit::slopes() const {
  const Index n = sheet->count(), scan = misfit.cols();
  Matrix read, ground;
  prediction->aside(read, ground);
  Matrix columns(n * scan, 4), in_rows(n * scan, 3);
  for (Index l = 0; l < scan; ++l) {
    const Index at = n * l;
    columns.col(0).segment(at, n) = (prediction->readings.col(l) - unknowns.offset).cwiseQuotient(unknowns.gain);
    in_rows.col(0).segment(at, n) = unknowns.gain.cwiseProduct(prediction->ratio.col(l)) / prediction->own[l];
    for (int d = 0; d < 2; ++d) {
      columns.col(2 + d).segment(at, n) = unknowns.gain.cwiseProduct(read.col(d).segment(at, n));
      in_rows.col(1 + d).segment(at, n) = unknowns.gain.cwiseProduct(ground.col(d).segment(at, n));
    }
  }
  columns.col(1).setOnes();
  return Slopes(std::move(columns), std::move(in_rows), rows->grounded, n);
}

void contact_priors(const Fit& fit, Matrix& curvature, Vector& pull) {
  const Unknowns& u = fit.unknowns;
  const Prior& prior = *fit.prior;
  const double size = fit.sheet->tables().outline.size.maxCoeff();
  const Index free = u.free.count();
  Vector diagonal(free + 3 * u.rated());
  pull = Vector::Zero(diagonal.size());
  Index at = 0;
  for (Index i = 0; i < u.alone(); ++i)
    for (int which = 0; which < 6; ++which) {
      if (!u.free(which, i)) continue;
      const double value = u.contacts(which, i);
      if (which <= kY) {
        diagonal[at] = 1 / (size * size);  // somewhere
      } else if (which == kStrength) {
        diagonal[at] = kAnyStrength;
      } else if (which == kRadius) {
        diagonal[at] = 1 / (prior.spread * prior.spread);
        pull[at] = (std::log(prior.radius) - value) * diagonal[at];
      } else {
        diagonal[at] = 1 / (prior.stretch * prior.stretch);
        pull[at] = -value * diagonal[at];
      }
      ++at;
    }
  for (Index i = 0; i < u.contacts.cols(); ++i) {
    if (!u.moving[i]) continue;
    diagonal.segment<3>(at) = prior.rates.cwiseAbs2().cwiseInverse();
    pull.segment<3>(at) = -u.rates.col(i).cwiseProduct(diagonal.segment<3>(at));
    at += 3;
  }
  curvature = diagonal.asDiagonal();
  if (!u.bond.size()) return;  // else nothing moves: conductances of cells are the last ones
  const Vector strengths = u.of_cells();
  curvature.bottomRightCorner(u.bond.rows(), u.bond.cols()) = strengths.asDiagonal() * u.bond * strengths.asDiagonal();
  pull.tail(u.bond.rows()) = -strengths.cwiseProduct(u.bond * strengths);
}

}  // namespace tomotactile
