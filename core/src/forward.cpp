#include "tomotactile/forward.hpp"

#include <cmath>

#include "tomotactile/linear_algebra.hpp"

namespace tomotactile {
namespace {

// What contacts change by on both sides of a time for which they are evaluated, spacings and ln c: half as much takes
// twice the time, and what the model errs where contacts cross electrodes is more.
constexpr double kWay = 0.2, kStrengthened = 0.1;
constexpr int kMost = 200;  // evaluations before, and after the middle: faster is no motion

Mask rated(const Unknowns& unknowns) {
  Mask out = Mask::Constant(6, unknowns.contacts.cols(), false);
  for (Index i = 0; i < unknowns.contacts.cols(); ++i)
    if (unknowns.moving[i]) out(kX, i) = out(kY, i) = out(kStrength, i) = true;
  return out;
}

// Columns of `wanted` that `chosen` names, in order.
std::vector<int> among(const Mask& wanted, const Mask& chosen) {
  std::vector<int> out;
  int column = 0;
  for (Index e = 0; e < wanted.size(); ++e) {
    if (!wanted(e)) continue;
    if (chosen(e)) out.push_back(column);
    ++column;
  }
  return out;
}

}  // namespace

bool Unknowns::is_moving() const { return rated() > 0; }

Index Unknowns::rated() const { return std::count(moving.begin(), moving.end(), true); }

bool Unknowns::is_finite() const {
  return contacts.allFinite() && rates.allFinite() && sheet.allFinite() && gain.allFinite() && offset.allFinite() &&
         resistance.allFinite() && aside.allFinite() && bond.allFinite();
}

void Unknowns::check(const Sheet& on) const {
  const Index k = contacts.cols(), n = on.count();
  if (Index(across.size()) != k || free.cols() != k || rates.cols() != k || Index(moving.size()) != k)
    throw BadInput("contacts, patches, free parameters and rates differ in number");
  if (bond.size()) {
    if (bond.rows() > k || bond.cols() != bond.rows()) throw BadInput("the bond of cells has another size");
    Mask strengths = Mask::Constant(6, bond.rows(), false);
    strengths.row(kStrength).setConstant(true);
    if ((free.rightCols(bond.rows()) != strengths).any() || is_moving()) throw BadInput("of cells that are bonded the conductances alone are free");
  }
  if (sheet.size() != on.modes()) throw BadInput("coefficients of the sheet are not as many as its modes");
  if (!is_finite()) throw BadInput("contacts, sheet and channels must be finite");
  if (gain.size() != n || offset.size() != n || resistance.size() != n || aside.rows() != n)
    throw BadInput("gains, offsets, resistances, places are not given for each electrode in use");
}

Snapshot::Snapshot(std::shared_ptr<const Sheet> on, const Unknowns& u, const std::vector<int>& grounded,
                   std::shared_ptr<const Touches> known)
    : sheet(std::move(on)), touches(std::move(known)), rows(grounded) {
  const Index n = sheet->count(), scan = Index(rows.size());
  if (u.contacts.cols()) {
    if (!touches) touches = std::make_shared<Touches>(sheet, u.contacts, u.across, u.sheet, u.bond.rows());
    const Touches& t = *touches;
    direct_ = Vector::Zero(n);
    Vector root(t.patches());
    for (Index i = 0; i < t.count(); ++i) {
      conductance.push_back(t.conductance(i));
      direct_ += conductance[i].value * t.direct.col(i);
      root.segment(t.begin(i), t.size(i)) = (conductance[i].value * t.weight.segment(t.begin(i), t.size(i))).cwiseSqrt();
    }
    // C = S (1 + S D S)^-1 S with S^2 = G, also where a patch has no weight; groups do not feel each other
    fed_.resize(n, t.patches()), inner_.resize(n, t.patches());
    for (const std::vector<int>& group : t.groups()) {
      if (group.empty()) continue;
      const Vector roots = root(group);
      const Matrix share = t.share(Eigen::all, group), between = t.impedance(group, group);
      Matrix system = roots.asDiagonal() * between * roots.asDiagonal();
      system.diagonal().array() += 1;
      const Matrix fed = solved(system, roots.asDiagonal() * share.transpose()).transpose() * roots.asDiagonal();
      fed_(Eigen::all, group) = fed;
      inner_(Eigen::all, group) = share - fed * between;
    }
    impedance = inverse_of(sheet->admittance_of(u.sheet) + added());
  } else {
    touches = nullptr;
    impedance = sheet->untouched();
  }
  ratio = impedance(Eigen::all, rows);
  own.resize(scan), within.resize(scan);
  const Vector inside = sheet->inside(u.sheet);
  for (Index l = 0; l < scan; ++l) {
    own[l] = ratio(rows[l], l) + inside[rows[l]] + u.resistance[rows[l]];
    ratio.col(l) /= own[l];
    within[l] = inside[rows[l]] / own[l];
  }
  shifted = 1.0 - ratio.array();
  for (Index l = 0; l < scan; ++l) shifted(rows[l], l) -= within[l];
  if (!u.aside.isZero(0.0)) {
    const std::array<Matrix, 2> at = fields();
    const Matrix along = u.aside.col(0).asDiagonal() * at[0] + Matrix(u.aside.col(1).asDiagonal() * at[1]);
    Matrix moved = -along * ratio;
    const Matrix taken = along(rows, Eigen::all).transpose(), through = impedance * taken;
    for (Index l = 0; l < scan; ++l) {
      const double at_ground = -moved(rows[l], l);
      moved(rows[l], l) = 0;
      moved.col(l) += ratio.col(l) * (at_ground + taken.col(l).dot(impedance.col(rows[l])) / own[l]);
      moved.col(l) -= through.col(l) / own[l];
      moved(rows[l], l) -= at_ground;
    }
    shifted += moved;
  }
}

Matrix Snapshot::added() const {
  Matrix out = touches->share * fed_.transpose();
  out.diagonal() += direct_;
  return out;
}

std::array<Matrix, 2> Snapshot::fields() const {
  std::array<Matrix, 2> out = sheet->tables().fields;
  if (!touches) return out;
  const std::array<Matrix, 2> kernel = sheet->kernel(touches->places());
  for (int d = 0; d < 2; ++d) out[d].noalias() -= (kernel[d] - sheet->tables().between[d] * touches->share) * fed_.transpose();
  return out;
}

void Snapshot::aside(Matrix& read, Matrix& ground) const {
  const Index n = sheet->count(), scan = Index(rows.size());
  read.resize(n * scan, 2), ground.resize(n * scan, 2);
  const std::array<Matrix, 2> at = fields();
  for (int d = 0; d < 2; ++d) {
    Eigen::Map<Matrix> columns(read.col(d).data(), n, scan), ways(ground.col(d).data(), n, scan);
    columns.noalias() = -at[d] * ratio;
    const Matrix taken = at[d](rows, Eigen::all).transpose(), through = impedance * taken;
    for (Index l = 0; l < scan; ++l) {
      const double at_ground = -columns(rows[l], l), felt = taken.col(l).dot(impedance.col(rows[l]));
      columns(rows[l], l) = 0;
      ways.col(l) = ratio.col(l) * at_ground - (through.col(l) - felt * ratio.col(l)) / own[l];
      ways(rows[l], l) -= at_ground;
    }
  }
}

// Of a product Z dY rho, where it is known, what follows of the readings.
static void grounded(const Snapshot& at, Eigen::Map<Matrix> moved) {
  for (Index l = 0; l < at.ratio.cols(); ++l) {
    const double own = moved(at.rows[l], l);
    moved.col(l) -= own * at.ratio.col(l);
    moved(at.rows[l], l) -= own * at.within[l];
  }
}

void Snapshot::feed(const Vector& direct, Eigen::Map<Matrix>& moved) const {
  for (Index e = 0; e < direct.size(); ++e)
    if (direct[e] != 0) moved.noalias() += (direct[e] * impedance.col(e)) * ratio.row(e);
}

void Snapshot::respond(const Matrix& change, Eigen::Ref<Vector> out) const {
  Eigen::Map<Matrix> moved(out.data(), ratio.rows(), ratio.cols());
  moved.noalias() = impedance * (change * ratio);
  grounded(*this, moved);
}

Matrix Snapshot::columns(const Mask& free) const {
  const Index n = sheet->count(), scan = ratio.cols();
  Matrix out(n * scan, free.count());
  if (!out.cols()) return out;
  const Touches& t = *touches;
  const Matrix driven = inner_.transpose() * ratio, felt = impedance * inner_;  // by and through patches: P x L, n x P
  Index column = 0;
  for (Index i = 0; i < t.count(); ++i) {
    const Index first = t.begin(i), size = t.size(i);
    const double g = conductance[i].value;
    const auto inner = felt.middleCols(first, size);
    const auto own = driven.middleRows(first, size);
    const auto on_electrodes = [&](Eigen::Map<Matrix>& moved, const Vector& direct) {
      feed(direct, moved);
      grounded(*this, moved);
    };
    bool moves_patches = false;
    for (int which : kMoving) moves_patches |= free(which, i);
    std::array<Points, 5> moves;
    Matrix by_weight, by_direct, grown, seen, left, right;
    std::array<Matrix, 2> sent, drawn;  // H by places, all else as it is, through the sheet and by the rows
    Eigen::Matrix<double, 5, 1> by_mean;
    if (moves_patches) {
      const Slope slope = t.impedance_slope(i);
      by_mean = conductance[i].by_mean * t.mean_change(i, slope);
      moves = t.moves(i), drawn = t.share_slopes(i, slope);
      t.covered_change(i, by_weight, by_direct);
      const auto around = fed_.middleCols(first, size);
      const Matrix near = fed_(Eigen::all, t.near(i));
      drawn[0].noalias() -= near * slope.along_x.transpose();
      drawn[1].noalias() -= near * slope.along_y.transpose();
      for (int d = 0; d < 2; ++d) sent[d] = impedance * drawn[d], drawn[d] = (drawn[d].transpose() * ratio).eval();
      seen = around.transpose() * ratio;
      // by what is sent elsewhere, drawn from elsewhere and conducted more, in one product
      left.resize(n, 3 * size), right.resize(3 * size, scan);
      left.middleCols(size, size).noalias() = impedance * around;
      left.rightCols(size) = inner, right.topRows(size) = seen;
      if (free(kRadius, i)) grown = slope.grown;
    }
    for (int which = 0; which < 6; ++which) {
      if (!free(which, i)) continue;
      Eigen::Map<Matrix> moved(out.col(column++).data(), n, scan);
      if (which == kStrength) {
        const double rate = conductance[i].by_strength * g;
        moved.noalias() = (inner * (rate * t.weight.segment(first, size)).asDiagonal()) * own;
        on_electrodes(moved, rate * t.direct.col(i));
        continue;
      }
      int k = 0;
      while (kMoving[k] != which) ++k;
      const Vector x = moves[k].row(0), y = moves[k].row(1);
      left.leftCols(size) = sent[0] * x.asDiagonal() + sent[1] * y.asDiagonal();
      right.middleRows(size, size) = x.asDiagonal() * drawn[0] + y.asDiagonal() * drawn[1];
      if (which == kRadius) right.middleRows(size, size).noalias() += grown * seen;
      right.bottomRows(size) = (g * (by_mean[k] * t.weight.segment(first, size) + by_weight.col(k))).asDiagonal() * own;
      moved.noalias() = left * right;
      on_electrodes(moved, g * (by_mean[k] * t.direct.col(i) + by_direct.col(k)));
    }
  }
  return out;
}

// Change of Y by the logarithm of D of contact i, c held.
Matrix Snapshot::by_way(Index i) const {
  const Touches& t = *touches;
  const Index first = t.begin(i), size = t.size(i);
  const std::vector<int>& near = t.near(i);
  const Matrix mine = t.impedance(Eigen::seqN(first, size), near), fed = fed_(Eigen::all, near);
  const Matrix felt = fed_.middleCols(first, size) * (mine * fed.transpose());
  const double rate = conductance[i].value * conductance[i].by_mean * t.mean[i];
  const auto inner = inner_.middleCols(first, size);
  Matrix out = (inner * (rate * t.weight.segment(first, size)).asDiagonal()) * inner.transpose();
  out.diagonal() += rate * t.direct.col(i);
  out -= (felt + felt.transpose()) / 2;
  return out;
}

Matrix Snapshot::sheet_columns(const Vector& coefficients) const {
  const Index n = sheet->count(), scan = ratio.cols(), modes = sheet->modes();
  Matrix out = Matrix::Zero(n * scan, modes);
  if (!touches) return out;  // nothing touches: whatever leaks away
  const Touches& t = *touches;
  Matrix change = sheet->admittance_change(coefficients);
  const Matrix moved = t.around().spread(fed_) * sheet->tables().share_change(Eigen::all, t.around().nodes).transpose();
  const Matrix field = sheet->field_at(t.contacts.topRows<2>());
  for (Index j = 0; j < modes; ++j) {
    const auto each = moved.middleCols(n * j, n);
    change.middleCols(n * j, n) += each + each.transpose();
  }
  for (Index i = 0; i < t.count(); ++i) {
    const Matrix way = by_way(i);
    for (Index j = 0; j < modes; ++j)
      if (field(i, j) != 0) change.middleCols(n * j, n) -= field(i, j) * way;
  }
  // Z dY rho of all modes in two products, as each dY is symmetric
  const Matrix driven = ratio.transpose() * change;
  Matrix turned(n, scan * modes);
  for (Index j = 0; j < modes; ++j) turned.middleCols(scan * j, scan) = driven.middleCols(n * j, n).transpose();
  Eigen::Map<Matrix>(out.data(), n, scan * modes).noalias() = impedance * turned;
  for (Index j = 0; j < modes; ++j) grounded(*this, Eigen::Map<Matrix>(out.col(j).data(), n, scan));
  Eigen::Map<Matrix> last(out.col(modes - 1).data(), n, scan);
  for (Index l = 0; l < scan; ++l) {
    const double rate = sheet->tables().inside[rows[l]] / own[l];
    last.col(l) += rate * ratio.col(l);
    last(rows[l], l) += rate * (within[l] - 1.0);
  }
  return out;
}

Matrix Snapshot::way_columns() const {
  const Index k = touches ? touches->count() : 0;
  Matrix out(ratio.size(), k);
  if (!k) return out;
  const Touches& t = *touches;
  // what patches do to the rows and what the rows do to patches, as `by_way` has them; its rank is that of few patches
  const Matrix felt = impedance * inner_, driven = inner_.transpose() * ratio;
  const Matrix sent = impedance * fed_, drawn = fed_.transpose() * ratio;
  for (Index i = 0; i < k; ++i) {
    const Index first = t.begin(i), size = t.size(i);
    const std::vector<int>& near = t.near(i);
    const Matrix mine = t.impedance(Eigen::seqN(first, size), near);
    const double rate = conductance[i].value * conductance[i].by_mean * t.mean[i];
    Eigen::Map<Matrix> moved(out.col(i).data(), ratio.rows(), ratio.cols());
    moved.noalias() = (felt.middleCols(first, size) * (rate * t.weight.segment(first, size)).asDiagonal()) * driven.middleRows(first, size);
    const Matrix back = sent(Eigen::all, near) * mine.transpose() / 2, there = mine * drawn(near, Eigen::all) / 2;
    moved.noalias() -= sent.middleCols(first, size) * there;
    moved.noalias() -= back * drawn.middleRows(first, size);
    feed(rate * t.direct.col(i), moved);
    grounded(*this, moved);
  }
  return out;
}

Matrix Snapshot::pressure_columns(const std::vector<Matrix>& modes) const {
  const Index k = touches ? touches->count() : 0;
  if (Index(modes.size()) != k) throw BadInput("modes of the pressure are not given for each contact");
  Index total = 0, column = 0;
  for (const Matrix& each : modes) total += each.cols();
  Matrix out(ratio.size(), total), weight, direct;
  for (Index i = 0; i < k; ++i) {
    const Touches& t = *touches;
    const double g = conductance[i].value;
    const auto inner = inner_.middleCols(t.begin(i), t.size(i));
    t.pressure_change(i, modes[i], weight, direct);
    for (Index q = 0; q < modes[i].cols(); ++q) {
      Matrix change = (inner * (g * weight.col(q)).asDiagonal()) * inner.transpose();
      change.diagonal() += g * direct.col(q);
      respond(change, out.col(column++));
    }
  }
  return out;
}

Prediction::Prediction(std::shared_ptr<const Sheet> sheet, Unknowns given, std::vector<int> grounded, const Vector& times,
                       std::shared_ptr<const Touches> touches)
    : unknowns(std::move(given)), rows(std::move(grounded)), times_(times) {
  const Unknowns& u = unknowns;
  u.check(*sheet);
  const Index n = sheet->count(), scan = Index(rows.size());
  for (int row : rows)
    if (row < 0 || row >= n) throw BadInput("a row grounds an electrode that is not in use");
  if (times_.size() && times_.size() != scan) throw BadInput("times are not given for each row");
  const bool moves = times_.size() && u.is_moving();
  if (!moves) {
    std::vector<int> all(scan);
    for (Index l = 0; l < scan; ++l) all[l] = int(l);
    parts_.push_back({all, std::make_shared<Snapshot>(sheet, u, rows, touches)});
    const Snapshot& at = middle();
    ratio = at.ratio, own = at.own;
    readings = (u.gain.asDiagonal() * at.shifted).colwise() + u.offset;
    return;
  }
  const double last = times_.cwiseAbs().maxCoeff();
  double changes = 0;
  for (Index i = 0; i < u.contacts.cols(); ++i) {
    const double speed = u.rates.block<2, 1>(0, i).norm() / (kWay * sheet->tables().pitch);
    changes = std::max({changes, last * speed, last * std::abs(u.rates(2, i)) / kStrengthened});
  }
  if (!std::isfinite(changes)) throw BadInput("rates or times are not finite");
  const int aside = int(std::min(std::ceil(std::max(changes - 1, 0.0) / 2), double(kMost)));
  const double lasts = 2 * last / (2 * aside + 1);
  const Mask is_rated = rated(u);
  wanted_ = u.free || is_rated;
  columns_.resize(n * scan, wanted_.count());
  readings.resize(n, scan), ratio.resize(n, scan), own.resize(scan);
  std::vector<std::vector<int>> which(2 * aside + 1);
  for (Index l = 0; l < scan; ++l) {
    const double nearest = lasts > 0 ? std::nearbyint(times_[l] / lasts) : 0.0;
    which[aside + int(std::min(std::max(nearest, -double(aside)), double(aside)))].push_back(int(l));
  }
  const std::vector<int> drifting = among(wanted_, is_rated);
  Vector rates(drifting.size());
  for (Index i = 0, r = 0; i < u.contacts.cols(); ++i)
    if (u.moving[i]) rates.segment<3>(r) = u.rates.col(i), r += 3;
  for (int each = -aside; each <= aside; ++each) {
    const std::vector<int>& mine = which[aside + each];
    if (each != 0 && mine.empty()) continue;
    Unknowns here = u;
    for (int d = 0; d < 3; ++d) here.contacts.row(d) += each * lasts * u.rates.row(d);
    std::vector<int> ground;
    for (int l : mine) ground.push_back(rows[l]);
    if (each == 0) middle_ = parts_.size();
    parts_.push_back({mine, std::make_shared<Snapshot>(sheet, here, ground, nullptr)});
    const Snapshot& at = *parts_.back().at;
    const Matrix columns = at.columns(wanted_);
    const Vector drift = columns(Eigen::all, drifting) * rates;
    for (std::size_t j = 0; j < mine.size(); ++j) {
      const int l = mine[j];
      columns_.middleRows(n * l, n) = columns.middleRows(n * Index(j), n);
      const double since = times_[l] - each * lasts;
      readings.col(l) = u.gain.cwiseProduct(at.shifted.col(j) + since * drift.segment(n * Index(j), n)) + u.offset;
      ratio.col(l) = at.ratio.col(j), own[l] = at.own[j];
    }
  }
}

Index Prediction::work() const {
  Index out = 0;
  for (const Part& part : parts_) out += part.at->touches ? part.at->touches->patches() : 0;
  return out;
}

// Puts what is known of each part in the order of the rows, times the gains.
Matrix Prediction::gather(const std::function<Matrix(const Snapshot&)>& columns, bool gained) const {
  const Index n = count();
  Matrix out;
  if (parts_.size() == 1 && Index(parts_[0].which.size()) == readings.cols()) {
    out = columns(*parts_[0].at);
  } else {
    for (const Part& part : parts_) {
      const Matrix mine = columns(*part.at);
      if (!out.size()) out.resize(readings.size(), mine.cols());
      for (std::size_t j = 0; j < part.which.size(); ++j)
        out.middleRows(n * part.which[j], n) = mine.middleRows(n * Index(j), n);
    }
  }
  if (gained)
    for (Index c = 0; c < out.cols(); ++c)
      Eigen::Map<Matrix>(out.col(c).data(), n, readings.cols()).array().colwise() *= unknowns.gain.array();
  return out;
}

Matrix Prediction::columns(const Mask& wanted) const {
  Matrix out;
  if (wanted_.size() == wanted.size() && wanted_.size() && (wanted_ || !wanted).all()) {
    out = columns_(Eigen::all, among(wanted_, wanted));
    for (Index c = 0; c < out.cols(); ++c)
      Eigen::Map<Matrix>(out.col(c).data(), count(), readings.cols()).array().colwise() *= unknowns.gain.array();
    return out;
  }
  return gather([&](const Snapshot& at) { return at.columns(wanted); }, true);
}

Matrix Prediction::contact_columns(const Unknowns& u) const {
  if (u.free.cols() != (middle().touches ? middle().touches->count() : 0)) throw BadInput("free parameters do not fit the contacts");
  if (!times_.size() || !u.is_moving()) return columns(u.free);
  const Matrix free = columns(u.free), rates = columns(rated(u));
  Matrix out(free.rows(), free.cols() + rates.cols());
  out << free, rates;
  for (Index l = 0; l < readings.cols(); ++l) out.block(count() * l, free.cols(), count(), rates.cols()) *= times_[l];
  return out;
}

Matrix Prediction::sheet_columns() const {
  return gather([&](const Snapshot& at) { return at.sheet_columns(unknowns.sheet); }, true);
}

Matrix Prediction::way_columns() const {
  return gather([](const Snapshot& at) { return at.way_columns(); }, true);
}

Matrix Prediction::pressure_columns(const std::vector<Matrix>& modes) const {
  return gather([&](const Snapshot& at) { return at.pressure_columns(modes); }, true);
}

void Prediction::aside(Matrix& read, Matrix& ground) const {
  const Matrix both = gather(
      [](const Snapshot& at) {
        Matrix read, ground, out(at.ratio.size(), 4);
        at.aside(read, ground);
        out << read, ground;
        return out;
      },
      false);
  read = both.leftCols(2), ground = both.rightCols(2);
}

}  // namespace tomotactile
