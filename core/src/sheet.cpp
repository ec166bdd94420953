#include "tomotactile/sheet.hpp"

#include <cmath>

namespace tomotactile {
namespace {


// Diagonals that make the rows sum to 0: a floating sheet conducts nothing away.
void balance(Eigen::Ref<Matrix> matrix) {
  matrix.diagonal().setZero();
  const Vector sums = matrix.rowwise().sum();
  matrix.diagonal() = -sums;
}

void expect(bool right, const char* what) {
  if (!right) throw BadInput(std::string("tables of the sheet: ") + what);
}

}  // namespace

void Tables::complete() {
  const Index n = admittance.rows(), all = centres.cols(), points = coarse.points();
  expect(n >= 1 && admittance.cols() == n, "admittance is not square");
  expect(inverse.rows() == n + 1 && inverse.cols() == n + 1, "the bordered inverse does not fit the admittance");
  expect(used.cols() == n, "places of electrodes do not fit the admittance");
  expect(Index(position.size()) == all, "positions do not fit the electrodes");
  for (int each : position) expect(each >= 0 && each <= n, "a position is none of an electrode");
  expect(fine.counts.minCoeff() >= 4 && coarse.counts.minCoeff() >= 4, "a lattice has fewer than 4 points to a side");
  expect(fine.step.minCoeff() > 0 && coarse.step.minCoeff() > 0, "a lattice has no size");
  expect(potentials.rows() == n && potentials.cols() == fine.points(), "potentials do not fit their lattice");
  expect(own.size() == fine.points(), "own potentials do not fit their lattice");
  expect(smooth.rows() == points && smooth.cols() == points, "the smooth part does not fit its lattice");
  expect(change.rows() == n && change.cols() % n == 0 && change.cols() >= 2 * n, "modes of Y0 have another size");
  expect(share_change.rows() == change.cols() && share_change.cols() == points, "modes of H have another size");
  expect(inside.size() == n, "what a radius changes does not fit the electrodes");
  expect(seen.rows() == n && seen.cols() == n, "pairs that see each other do not fit the admittance");
  expect(nodes.rows() == cells.cols() && nodes.cols() <= change.cols() / n, "cells of the field do not fit the modes");
  for (const Matrix& each : fields) expect(each.rows() == n && each.cols() == n, "fields do not fit the admittance");
  for (const Mirror& each : mirrors) expect(each.electrode >= 0 && each.electrode < n, "a mirror of no electrode");
  expect(radius > 0 && resistance > 0 && pitch > 0 && reach > 0, "radius, resistance, spacing must be above 0");
  for (const Cut& each : discs)
    expect(each.points.cols() == each.area.size() && each.area.size() == each.radii.size(), "patches do not fit each other");
  expect(induced.centres.cols() == all, "induced charges do not fit the electrodes");
  between = Sheet::kernel_of(*this, used);
  fed = induced.fed(used);
  counted.resize(n);
  for (Index e = 0; e < all; ++e)
    if (position[e] < n) counted[position[e]] = induced.counted[e];
}

Sheet::Sheet(std::shared_ptr<const Tables> tables, Matrix untouched)
    : tables_(std::move(tables)), untouched_(std::move(untouched)), mean_(Vector::Zero(modes())) {
  expect(untouched_.rows() == count() && untouched_.cols() == count(), "the untouched sheet has another size");
}

Sheet::Sheet(std::shared_ptr<const Tables> tables, Matrix untouched, Vector mean, Rest rest)
    : Sheet(std::move(tables), std::move(untouched)) {
  mean_ = std::move(mean);
  const Index n = count(), points = tables_->coarse.points();
  expect(mean_.size() == modes(), "coefficients are as many as modes");
  expect(rest.factor.rows() == n && rest.factor.cols() == n && rest.term.rows() == n && rest.term.cols() == n &&
             rest.share.rows() == n && rest.share.cols() == points && rest.own.size() == points,
         "what first order leaves has another size");
  rest_ = std::make_shared<const Rest>(std::move(rest));
}

Matrix Sheet::changed(const Vector& sheet) const {
  Matrix out(count(), count());
  const Eigen::Map<const Matrix> modes(tables_->change.data(), out.size(), sheet.size());
  Eigen::Map<Vector>(out.data(), out.size()).noalias() = modes * sheet;
  return out;
}

Matrix Sheet::scaled(const Matrix& changed) const {
  Matrix logarithm = changed;
  if (rest_) logarithm += rest_->factor;
  return tables_->admittance.cwiseProduct(logarithm.cwiseMax(-2.0).cwiseMin(2.0).array().exp().matrix());
}

Matrix Sheet::admittance_of(const Vector& sheet) const {
  if (even(sheet)) return tables_->admittance;
  const Matrix change = changed(sheet), factor = scaled(change);
  Matrix out = tables_->seen.select(factor, tables_->admittance + change);
  if (rest_) out += rest_->term;
  balance(out);
  return out;
}

Matrix Sheet::admittance_change(const Vector& sheet) const {
  const Index n = count();
  const Matrix scale = even(sheet) ? tables_->admittance : scaled(changed(sheet)), factor = tables_->seen.select(scale, 1.0);
  Matrix out(n, n * modes());
  for (Index j = 0; j < modes(); ++j) {
    auto each = out.middleCols(n * j, n);
    each = tables_->change.middleCols(n * j, n).cwiseProduct(factor);
    balance(each);
  }
  return out;
}

Matrix Sheet::share_added(const Vector& sheet, const std::vector<int>& nodes) const {
  Matrix out = rest_ ? Matrix(rest_->share(Eigen::all, nodes)) : Matrix::Zero(count(), nodes.size());
  for (std::size_t m = 0; m < nodes.size(); ++m)
    out.col(m).noalias() += Eigen::Map<const Matrix>(tables_->share_change.col(nodes[m]).data(), count(), modes()) * sheet;
  return out;
}

// Where it is not about an even one.
Vector Sheet::own_added(const Around& around) const {
  return around.values(rest_->own(around.nodes).transpose()).transpose();
}

Matrix Sheet::field_at(const Points& places) const {
  const Points& cells = tables_->cells;
  Matrix weights(places.cols(), cells.cols());
  for (Index q = 0; q < places.cols(); ++q) {
    const Eigen::ArrayXd squared = (cells.colwise() - places.col(q)).colwise().squaredNorm().transpose();
    const Eigen::ArrayXd weight = (-(squared - squared.minCoeff()) / (2 * tables_->reach * tables_->reach)).exp();
    weights.row(q) = (weight / weight.sum()).matrix();
  }
  Matrix out = Matrix::Zero(places.cols(), modes());
  out.leftCols(tables_->nodes.cols()).noalias() = weights * tables_->nodes;
  return out;
}

Matrix Sheet::potentials_at(const Points& places, const Matrix& dipoles) const {
  Matrix out = tables_->fed.transpose() * dipoles;
  add_read(places, &out, nullptr);
  return out;
}

std::array<Matrix, 2> Sheet::steep_at(const Points& places, const std::array<Matrix, 2>& dipole_slopes) const {
  std::array<Matrix, 2> out{tables_->fed.transpose() * dipole_slopes[0], tables_->fed.transpose() * dipole_slopes[1]};
  add_read(places, nullptr, &out);
  return out;
}

// Logarithms and what is read off the lattice.
void Sheet::add_read(const Points& places, Matrix* potentials, std::array<Matrix, 2>* slopes) const {
  const Tables& t = *tables_;
  const double least = t.radius * t.radius;
  const Eigen::ArrayXd scale = t.resistance / (2 * kPi) * t.counted.array();
  for (Index p = 0; p < places.cols(); ++p) {
    const Stencil stencil = t.fine.at(places(0, p), places(1, p));
    const Matrix near = t.potentials(Eigen::all, stencil.nodes);
    const auto read = [&](const std::array<double, 16>& weights) { return (near * Eigen::Map<const Vector>(weights.data(), 16)).array(); };
    const Eigen::ArrayXd x = t.used.row(0).transpose().array() - places(0, p), y = t.used.row(1).transpose().array() - places(1, p);
    const Eigen::ArrayXd squared = (x * x + y * y).max(least);
    if (potentials) potentials->col(p).array() += read(stencil.weights) - 0.5 * scale * squared.log();
    if (!slopes) continue;
    (*slopes)[0].col(p).array() += read(stencil.along_x) + scale / squared * x;
    (*slopes)[1].col(p).array() += read(stencil.along_y) + scale / squared * y;
  }
}

Matrix Sheet::potentials_sum(const Points& places, const std::array<Matrix, 3>& weights) const {
  const Tables& t = *tables_;
  const double least = t.radius * t.radius;
  const Vector scale = t.resistance / (2 * kPi) * t.counted;
  const Around around(t.fine, places);
  Matrix out = t.potentials(Eigen::all, around.nodes) * around.spread(weights).transpose();
  const Eigen::ArrayXXd x = t.used.row(0).transpose().replicate(1, places.cols()).array().rowwise() - places.row(0).array();
  const Eigen::ArrayXXd y = t.used.row(1).transpose().replicate(1, places.cols()).array().rowwise() - places.row(1).array();
  const Eigen::ArrayXXd squared = (x * x + y * y).max(least);
  Matrix of_logarithm = (-0.5 * squared.log()).matrix() * weights[0].transpose();
  of_logarithm.noalias() += (x / squared).matrix() * weights[1].transpose() + (y / squared).matrix() * weights[2].transpose();
  out += scale.asDiagonal() * of_logarithm;
  const std::array<Matrix, 2> steep = t.induced.dipole_slopes(places);
  Matrix dipoles = t.induced.dipoles(places) * weights[0].transpose();
  dipoles.noalias() += steep[0] * weights[1].transpose() + steep[1] * weights[2].transpose();
  out.noalias() += t.fed.transpose() * dipoles;
  return out;
}

// H of discs, and its slopes: G is harmonic, its mean over a disc that at the centre, but where the disc reaches an
// electrode, a ring: there the logarithm is averaged over the disc and the ring, the mean over the narrower one being a
// quarter of its radius squared times the Laplacian, as far as that is within.
void Sheet::even_discs_at(const Points& places, double radius, Matrix& share, std::array<Matrix, 2>& slopes) const {
  const Tables& t = *tables_;
  const Index n = count();
  const std::array<Matrix, 2> steep = t.induced.dipole_slopes(places);
  Matrix potentials = t.fed.transpose() * t.induced.dipoles(places);
  for (int d = 0; d < 2; ++d) slopes[d].noalias() = t.fed.transpose() * steep[d];
  add_read(places, &potentials, &slopes);
  const double wide = std::max(radius, t.radius), narrow = std::min(radius, t.radius);
  for (Index p = 0; p < places.cols(); ++p)
    for (Index e = 0; e < n; ++e) {
      const Eigen::Vector2d apart = places.col(p) - t.used.col(e);
      const double squared = apart.squaredNorm(), distance = std::sqrt(std::max(squared, 1e-18));
      if (!(distance < radius + t.radius)) continue;
      const double inside = std::min(distance / wide, 1.0);
      const double part = std::min(std::max((wide + narrow - distance) / (2 * narrow), 0.0), 1.0);
      const double mean = std::log(std::max(distance, wide)) - (1 - inside * inside) / 2 +
                          narrow * narrow / (2 * wide * wide) * part * part * (3 - 2 * part);
      const double slope = (inside < 1 ? distance / (wide * wide) : 1 / distance) -
                           narrow / (4 * wide * wide) * 6 * part * (1 - part);
      const double held = std::max(squared, t.radius * t.radius), scale = t.resistance / (2 * kPi) * t.counted[e];
      potentials(e, p) += scale * (0.5 * std::log(held) - mean);
      const double more = scale * (1 / held - slope / distance);
      slopes[0](e, p) += more * apart.x(), slopes[1](e, p) += more * apart.y();
    }
  const auto inverse = t.inverse.topLeftCorner(n, n);
  share = (inverse * potentials).colwise() + t.inverse.topRightCorner(n, 1).col(0);
  for (Matrix& each : slopes) each = (inverse.transpose() * each).eval();
}

void Sheet::discs_at(const Points& places, double radius, Matrix& share, std::array<Matrix, 2>& slopes) const {
  even_discs_at(places, radius, share, slopes);
  if (about_even()) return;
  const Around around(tables_->coarse, places);
  const Matrix added = share_added(mean_, around.nodes);
  share += around.values(added);
  slopes[0] += around.along_x(added, 0, places.cols()), slopes[1] += around.along_y(added, 0, places.cols());
}

Vector Sheet::alone_at(const Points& places) const {
  Vector out = Vector::Zero(places.cols());
  for (Index p = 0; p < places.cols(); ++p) {
    const Stencil stencil = tables_->fine.at(places(0, p), places(1, p));
    for (int k = 0; k < 16; ++k) out[p] += stencil.weights[k] * tables_->own[stencil.nodes[k]];
  }
  return out;
}

std::array<Vector, 2> Sheet::alone_steep_at(const Points& places) const {
  std::array<Vector, 2> out{Vector::Zero(places.cols()), Vector::Zero(places.cols())};
  for (Index p = 0; p < places.cols(); ++p) {
    const Stencil stencil = tables_->fine.at(places(0, p), places(1, p));
    for (int k = 0; k < 16; ++k) {
      out[0][p] += stencil.along_x[k] * tables_->own[stencil.nodes[k]];
      out[1][p] += stencil.along_y[k] * tables_->own[stencil.nodes[k]];
    }
  }
  return out;
}

std::array<Matrix, 2> Sheet::kernel_of(const Tables& t, const Points& places) {
  const double scale = t.resistance / (2 * kPi);
  std::array<Matrix, 2> out{Matrix::Zero(t.used.cols(), places.cols()), Matrix::Zero(t.used.cols(), places.cols())};
  // x + i y of the way to a place over its square; nothing of a place on the electrode itself
  const auto add = [&](Index electrode, Index p, double x, double y) {
    x -= t.used(0, electrode), y -= t.used(1, electrode);
    if (std::abs(x) + std::abs(y) < t.radius) return;
    const double over = scale / (x * x + y * y);
    out[0](electrode, p) += over * x, out[1](electrode, p) += over * y;
  };
  for (Index p = 0; p < places.cols(); ++p) {
    for (Index n = 0; n < t.used.cols(); ++n) add(n, p, places(0, p), places(1, p));
    const std::complex<double> at(places(0, p), places(1, p));
    for (const Mirror& mirror : t.mirrors) {
      const std::complex<double> image = mirror.straight * at + mirror.turned * std::conj(at) + mirror.shift;
      add(mirror.electrode, p, image.real(), image.imag());
    }
  }
  return out;
}

}  // namespace tomotactile
