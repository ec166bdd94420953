#include "tomotactile/equations.hpp"

#include <cmath>

namespace tomotactile {
namespace {

constexpr double kLeast = 1e-9;     // conductance of a contact in parts of an electrode's: far below what noise hides
constexpr double kMost = 1.2;       // in parts of one over its mean D: a bare conductor, beyond which nothing changes
constexpr double kSmall = 0.25;     // radius of the smallest contact, typical radii: 2.3 deviations of what is expected
constexpr double kPoint = 0.02;     // spacings: a radius that nothing tells from a point
constexpr double kRounding = 1e-11; // of the diagonal of the normal matrix
constexpr double kAlike = 0.1;      // of the largest admittance that a shape adds: the same for shapes
constexpr double kStill = 0.01;     // both for derivatives by contacts
constexpr double kBent = 0.02;      // of `answering`: with more between them equations of one fit tell wrong deviations

Vector scale_of(const Matrix& normal) { return normal.diagonal().cwiseSqrt().cwiseInverse(); }

Matrix scaled(const Matrix& normal, const Vector& scale) { return scale.asDiagonal() * normal * scale.asDiagonal(); }

Eigen::Map<const Vector> flat_of(const Matrix& matrix) { return {matrix.data(), matrix.size()}; }

// Whether cells add nearly the same to Y: neighbours may exchange what they conduct.
bool add_alike(const Fit& fit, const Matrix& known, double within) {
  const Matrix added = fit.prediction->middle().added();
  return (added - known).cwiseAbs().maxCoeff() < within * added.cwiseAbs().maxCoeff();
}

Matrix times_weights(const Matrix& columns, const Matrix& weights) { return flat_of(weights).asDiagonal() * columns; }

}  // namespace

bool similar(const Parameters& contacts, const Parameters& others, double pitch, double within) {
  if (contacts.cols() != others.cols()) return false;
  Eigen::Array<double, 6, 1> limits;
  limits << pitch, pitch, 4, 8, 8, 8;
  for (Index i = 0; i < contacts.cols(); ++i)
    if (!((contacts.col(i) - others.col(i)).array().abs() <= within * limits).all()) return false;
  return true;
}

SheetColumns::SheetColumns(const Fit& fit)
    : flat(fit.prediction->sheet_columns()), rows_(fit.rows), contacts_(fit.unknowns.contacts),
      bonded_(fit.unknowns.bond.size()) {
  weighted = times_weights(flat, fit.rows->weights);
  normal = Matrix::Zero(flat.cols(), flat.cols());
  const Matrix rooted = flat_of(fit.rows->weights).cwiseSqrt().asDiagonal() * flat;
  normal.selfadjointView<Eigen::Lower>().rankUpdate(rooted.transpose());
  normal = Matrix(normal.selfadjointView<Eigen::Lower>());
  if (bonded_) added_ = fit.prediction->middle().added();
}

bool SheetColumns::serves(const Fit& fit) const {
  const bool near = bonded_ && fit.unknowns.bond.size()
                        ? add_alike(fit, added_, kAlike)
                        : similar(fit.unknowns.contacts, contacts_, fit.sheet->tables().pitch, kSimilar);
  return near && rows_->same(*fit.rows);
}

Equations::Equations(std::shared_ptr<const Fit> at, Matrix flat, const Matrix& of_contacts, std::shared_ptr<const SheetColumns> known)
    : fit(std::move(at)), contacts(std::move(flat)),
      sheet(known && known->serves(*fit) ? std::move(known) : std::make_shared<SheetColumns>(*fit)),
      channels(contacts, sheet->weighted, fit->rows->weights, fit->slopes(), *fit->prior) {
  const Index f = contacts.cols(), modes = sheet->flat.cols();
  normal.resize(f + modes, f + modes);
  normal.topLeftCorner(f, f) = of_contacts;
  normal.topRightCorner(f, modes).noalias() = contacts.transpose() * sheet->flat;
  normal.bottomLeftCorner(modes, f) = normal.topRightCorner(f, modes).transpose();
  normal.bottomRightCorner(modes, modes) = sheet->normal + fit->prior->of_sheet();
  const Vector diagonal = normal.diagonal();
  normal -= channels.normal;
  normal.diagonal() += kRounding * diagonal;  // what rounding takes off a difference of matrices
  const Matrix units = scaled(normal, scale_of(normal));
  const Matrix mixed = units.bottomLeftCorner(modes, f);
  const Matrix follow = solved(units.bottomRightCorner(modes, modes), mixed);
  stiffness = 1 - mixed.cwiseProduct(follow).colwise().sum().transpose().array();
}

Matrix Equations::inverse() const {
  const Vector scale = scale_of(normal);
  return scaled(inverse_of(scaled(normal, scale)), scale);
}

Matrix Equations::response(const Matrix& misfits) const {
  const Index f = contacts.cols();
  Matrix right(normal.rows(), misfits.cols());
  right.topRows(f).noalias() = contacts.transpose() * misfits;
  right.bottomRows(normal.rows() - f).noalias() = sheet->weighted.transpose() * misfits;
  for (Index m = 0; m < misfits.cols(); ++m) {
    const Eigen::Map<const Matrix> misfit(misfits.col(m).data(), fit->misfit.rows(), fit->misfit.cols());
    right.col(m) -= channels.pulled(misfit, Vector()).taken;
  }
  const Vector scale = scale_of(normal);
  const Matrix found = solved(scaled(normal, scale), scale.asDiagonal() * right);
  return (scale.asDiagonal() * found).topRows(f);
}

double Equations::score(const Fit& other, const Mask& free) const {
  Unknowns freed = other.unknowns;
  freed.free = free;
  Fit with = other;
  with.unknowns = freed;
  Matrix curvature, mixed, back;
  Vector pull;
  contact_priors(with, curvature, pull);
  const Index count = free.count();
  const Matrix columns = other.prediction->contact_columns(freed).leftCols(count);
  const Matrix weighted = times_weights(columns, other.rows->weights);
  channels.beside(weighted, mixed, back);
  Matrix others(count, normal.rows());
  others << columns.transpose() * contacts, columns.transpose() * sheet->weighted;
  others -= mixed * channels.back;
  Matrix own = weighted.transpose() * columns - mixed * back + curvature.topLeftCorner(count, count);
  const Linear along = Linear::of_all(std::make_shared<Fit>(other), std::make_shared<Equations>(*this));
  Vector right = weighted.transpose() * flat_of(other.misfit) + pull.head(count) - mixed * along.alone;
  const Vector scale = scale_of(normal);
  const Matrix follow = scale.asDiagonal() * solved(scaled(normal, scale), scale.asDiagonal() * others.transpose());
  own -= others * follow;
  right -= follow.transpose() * along.right;
  return right.dot(least_squares(own, right));
}

double Equations::unevenness(const Fit& other) const {
  const Index modes = sheet->flat.cols();
  const Matrix expected = other.prior->of_sheet();
  const Vector apart = other.unknowns.sheet - other.prior->mean.head(modes);
  const double told = double(modes) - inverse().bottomRightCorner(modes, modes).cwiseProduct(expected).sum();
  return std::max(std::sqrt(std::max(apart.dot(expected * apart), 0.0) / std::max(told, 1.0)), 1.0);
}

Vector answering(const Prediction& prediction) {
  const Snapshot& at = prediction.middle();
  Vector out(at.conductance.size());
  for (Index i = 0; i < out.size(); ++i)
    out[i] = at.conductance[i].by_strength / (1 + at.conductance[i].value * at.touches->mean[i]);
  return out;
}

bool Equations::bends(const Fit& other) const {
  const Index alone = other.unknowns.alone();
  if (fit->unknowns.alone() != alone) return true;
  const Vector known = answering(*fit->prediction).head(alone), here = answering(*other.prediction).head(alone);
  return ((known - here).array().abs() > kBent).any();
}

bool Equations::are_of(const Fit& other) const {
  const Unknowns &known = fit->unknowns, &here = other.unknowns;
  return known.free.cols() == here.free.cols() && (known.free == here.free).all() && !known.is_moving() && !here.is_moving() &&
         fit->rows->same(*other.rows) && fit->prior->same_sensor(*other.prior) && known.bond.rows() == here.bond.rows() &&
         known.bond == here.bond;
}

bool Equations::serves(const Fit& other) const {
  const Unknowns &known = fit->unknowns, &here = other.unknowns;
  if (!are_of(other)) return false;
  const Index alone = here.alone(), cells = here.bond.rows();
  if (bends(other) ||
      !similar(known.contacts.leftCols(alone), here.contacts.leftCols(alone), fit->sheet->tables().pitch, kStill))
    return false;
  if (!cells) return true;
  Parameters in_place = known.contacts.rightCols(cells);
  in_place.row(kStrength) = here.contacts.row(kStrength).tail(cells);
  return in_place == here.contacts.rightCols(cells) && add_alike(other, fit->prediction->middle().added(), kStill);
}

Linear Linear::of_contacts(std::shared_ptr<const Fit> at) {
  Linear out;
  Matrix curvature;
  Vector pull;
  contact_priors(*at, curvature, pull);
  const Matrix columns = at->prediction->contact_columns(at->unknowns);
  out.free = columns.cols();
  out.flat = times_weights(columns, at->rows->weights);
  out.normal.resize(out.free, out.free);
  out.normal.triangularView<Eigen::Lower>() = out.flat.transpose() * columns;
  out.normal = Matrix(out.normal.selfadjointView<Eigen::Lower>()) + curvature;
  out.stiffness = Vector::Ones(out.free);
  out.fit = std::move(at);
  out.aim(pull);
  return out;
}

Linear Linear::of_all(std::shared_ptr<const Fit> at, std::shared_ptr<const Equations> known, Taken taken) {
  Linear out;
  Matrix curvature;
  Vector pull;
  contact_priors(*at, curvature, pull);
  if (!known || taken == Taken::kSheet || !(taken == Taken::kAll ? known->are_of(*at) : known->serves(*at))) {
    Linear contacts = of_contacts(at);
    known = std::make_shared<Equations>(at, std::move(contacts.flat), contacts.normal, known ? known->sheet : nullptr);
  }
  out.free = pull.size();
  out.fit = std::move(at);
  out.normal = known->normal, out.stiffness = known->stiffness;
  if (const Index cells = out.fit->unknowns.bond.rows()) {  // readings are linear in what cells conduct, not in its logarithm
    out.units = Vector::Ones(out.free);
    out.units.tail(cells) = out.fit->unknowns.of_cells().cwiseQuotient(known->fit->unknowns.of_cells());
    out.normal.topRows(out.free).array().colwise() *= out.units.array();
    out.normal.leftCols(out.free).array().rowwise() *= out.units.array().transpose();
  }
  out.equations = std::move(known);
  out.aim(pull);
  return out;
}

Linear Linear::about(std::shared_ptr<const Fit> other) const {
  Linear out = *this;
  out.fit = std::move(other);
  Matrix curvature;
  Vector pull;
  contact_priors(*out.fit, curvature, pull);
  out.aim(pull);
  return out;
}

void Linear::aim(const Vector& pull) {
  const auto misfit = flat_of(fit->misfit);
  if (!equations) {
    right = flat.transpose() * misfit + pull;
    return;
  }
  const Vector sensor = -fit->prior->pull(fit->prior->apart(fit->unknowns));
  const Index modes = fit->sheet->modes();
  ChannelFit::Pulled pulled = equations->channels.pulled(fit->misfit, sensor.tail(sensor.size() - modes));
  right.resize(free + modes);
  right.head(free) = equations->contacts.transpose() * misfit;
  right.tail(modes) = equations->sheet->weighted.transpose() * misfit + sensor.head(modes);
  right -= pulled.taken;
  if (units.size()) right.head(free).array() *= units.array();
  right.head(free) += pull;
  alone = std::move(pulled.alone);
  beside = pulled.gain;
}

Step Linear::step(double damping) const {
  const Vector scale = scale_of(normal);
  Matrix system = scaled(normal, scale);
  system.diagonal().head(free) += damping * stiffness;
  Vector step = scale.cwiseProduct(solved(system, scale.cwiseProduct(right)).col(0));
  Step out;
  out.promised = step.dot(2 * right - normal * step) + beside;
  const double longer = excess(step);
  out.whole = damping <= kFirstDamping && longer == 1;
  step /= longer;
  out.unknowns = after(step);
  if (!out.unknowns.is_finite()) out.unknowns = fit->unknowns, out.promised = 0;  // of readings that nothing explains: no way leads on
  return out;
}

double Linear::excess(const Vector& step) const {
  const Unknowns& u = fit->unknowns;
  const double pitch = fit->sheet->tables().pitch;
  const double limits[6] = {kReach * pitch, kReach * pitch, kReachStrength, 0.5, 0.3, 0.3};
  double longest = 0;
  Index at = 0;
  for (Index i = 0; i < u.alone(); ++i)
    for (int which = 0; which < 6; ++which)
      if (u.free(which, i)) longest = std::max(longest, std::abs(step[at++]) / limits[which]);
  return std::max(longest, 1.0);
}

Unknowns Linear::after(const Vector& step) const {
  const Unknowns& u = fit->unknowns;
  Unknowns moved = u;
  Index at = 0;
  for (Index i = 0; i < u.contacts.cols(); ++i)
    for (int which = 0; which < 6; ++which)
      if (u.free(which, i)) moved.contacts(which, i) += step[at++];
  for (Index i = 0; i < u.contacts.cols(); ++i)
    if (u.moving[i]) moved.rates.col(i) += step.segment<3>(at), at += 3;
  const Tables& t = fit->sheet->tables();
  const double smallest = std::log(std::min(kPoint * t.pitch, kSmall * fit->prior->radius));
  const double largest = std::log(t.outline.size.maxCoeff()), least = std::log(kLeast * t.admittance.diagonal().maxCoeff());
  for (Index i = 0; i < u.contacts.cols(); ++i) {
    auto contact = moved.contacts.col(i);
    contact.head<2>() = contact.head<2>().cwiseMax(-t.outline.size / 2).cwiseMin(t.outline.size / 2);
    contact[kRadius] = std::min(std::max(contact[kRadius], smallest), largest);
    const double stretch = contact.tail<2>().norm();
    if (stretch > kLongest) contact.tail<2>() *= kLongest / stretch;
    const double most = std::log(kMost / std::max(fit->prediction->middle().touches->mean[i], 1e-9));
    contact[kStrength] = std::min(std::max(contact[kStrength], least), std::max(most, least));
  }
  return equations ? followed(std::move(moved), step) : moved;
}

Unknowns Linear::followed(Unknowns out, const Vector& step) const {
  const Unknowns& u = fit->unknowns;
  const Index n = fit->sheet->count();
  Vector own = step;
  if (units.size()) own.head(free).array() *= units.array();
  const Vector channels = equations->channels.step(alone, own);
  out.sheet = u.sheet + step.tail(fit->sheet->modes());
  out.gain = u.gain + channels.segment(0, n);
  out.offset = u.offset + channels.segment(n, n);
  out.resistance = u.resistance + channels.segment(2 * n, n);
  out.aside.col(0) = u.aside.col(0) + channels.segment(3 * n, n);
  out.aside.col(1) = u.aside.col(1) + channels.segment(4 * n, n);
  return out;
}

double Linear::promise() const {
  const Vector scale = scale_of(normal), goal = scale.cwiseProduct(right);
  return goal.dot(least_squares(scaled(normal, scale), goal)) + beside;
}

Matrix Linear::covariance() const {
  if (!equations) throw std::logic_error("covariance is that of contacts, sheet and channels");
  Matrix out = equations->inverse().topLeftCorner(free, free);
  if (!units.size()) return out;
  return units.cwiseInverse().asDiagonal() * out * units.cwiseInverse().asDiagonal();
}

}  // namespace tomotactile
