#include "tomotactile/rows.hpp"

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <numeric>

#include "tomotactile/contact.hpp"
#include "tomotactile/equations.hpp"
#include "tomotactile/linear_algebra.hpp"
#include "tomotactile/touches.hpp"

namespace tomotactile {
namespace {

constexpr double kInexact = 0.01;  // of a reading: what elements, electrodes and one patch to a contact err, deviation
// spacings, and of ln c and ln a, that contacts change before derivatives are taken anew; spacings before what they feel
// of each other is, which readings are predicted with
constexpr double kAlike = 0.03, kAsStrong = 0.1, kThere = 0.01;
// spacings: derivatives by the place of contacts nearer to the rim are those so far inside. On the rim of an insulated
// sheet they vanish: what ended there would stay, and seem to be known nowhere
constexpr double kInside = 0.1;
constexpr double kNotRead = 1e6;   // variance of a reading that was not read, parts of V0 squared
constexpr double kSettled = 0.05;  // standard deviations that a last step moves a contact
constexpr double kConducts = 1e-6, kBareConducts = 10;  // of the largest admittance of an electrode: of contacts
constexpr int kAcross = 6;         // patches to the width of a disc on a rim
constexpr double kBeside = 1e-3;   // of the area of a disc: less beside the electrode is nothing
constexpr double kCells = 32;      // to a spacing: derivatives of shares by the sheet are those of the middle of one
constexpr std::size_t kMost = 128; // of them are kept: what some contacts pass in a frame

Matrix lower(const Matrix& scatter) {
  const Eigen::LLT<Matrix> factor(scatter);
  if (factor.info() != Eigen::Success) throw std::domain_error("the covariance of a row is not positive definite");
  return factor.matrixL();
}

}  // namespace

RowModel::RowModel(std::shared_ptr<const Sheet> sheet, Sensor sensor, Matrix impedance, std::array<Matrix, 2> fields, Discs wide)
    : sheet_(std::move(sheet)), sensor_(std::move(sensor)), impedance_(std::move(impedance)), fields_(std::move(fields)),
      wide_(std::move(wide)), kept_(sheet_->count()) {
  const Index n = count();
  const Sensor& s = sensor_;
  const bool fits = s.sheet.size() == modes() && s.gain.size() == n && s.offset.size() == n && s.resistance.size() == n &&
                    s.resistance_deviation.size() == n && s.aside.rows() == n && s.unsure.rows() == n && s.alone.size() == n && s.deviation.size() == modes() + n &&
                    impedance_.rows() == n && impedance_.cols() == n;
  if (!fits) throw BadInput("what is known of the sensor does not fit its electrodes");
  for (const Matrix& each : fields_)
    if (each.rows() != n || each.cols() != n) throw BadInput("fields do not fit the electrodes");
  change_ = sheet_->admittance_change(s.sheet).cast<float>();
  within_ = sheet_->inside(s.sheet);
  const Tables& t = sheet_->tables();
  inside_ = (t.outline.size / 2).array() - kInside * t.pitch;
  if (!sheet_->even(s.sheet)) {
    std::vector<int> nodes(t.coarse.points());
    std::iota(nodes.begin(), nodes.end(), 0);
    added_ = sheet_->share_added(s.sheet, nodes);
  }
  const double largest = t.admittance.diagonal().maxCoeff();
  least_ = std::log(kConducts * largest), most_ = std::log(kBareConducts * largest);
}

// Shares (first column) and slopes of a disc that covers a rim in part, on an even sheet; false where it reaches none but
// the sheet's, or next to nothing of it lies beside the electrode.
bool RowModel::at_rim(const Eigen::Vector2d& place, double radius, Eigen::Matrix<double, Eigen::Dynamic, 3>& found) const {
  const Tables& t = sheet_->tables();
  Index which;
  const double apart = std::sqrt((t.used.colwise() - place).colwise().squaredNorm().minCoeff(&which));
  if (!(t.radius - radius < apart && apart < t.radius + radius)) return false;
  const Cut& cut = t.discs[kAcross];
  const Points places = (radius * cut.points).colwise() + place;
  Vector deep;
  Points inwards;
  t.outline.depth(places, deep, inwards);
  if ((deep.array() < 0).any()) return false;
  std::vector<int> there;
  Vector weight(places.cols());
  Points steep(2, places.cols());
  for (Index p = 0; p < places.cols(); ++p) {
    const Eigen::Vector2d way = places.col(p) - t.used.col(which);
    const double distance = way.norm();
    const Part off = outside_disc(distance, t.radius, radius * cut.radii[p]).part;
    weight[p] = cut.area[p] * off.value;
    steep.col(p) = cut.area[p] * off.by_distance / std::max(distance, 1e-12) * way;
    if (weight[p] > 0) there.push_back(int(p));
  }
  if (weight.sum() < kBeside) return false;
  const Eigen::Vector2d half = t.outline.size / 2;
  Points beside = places(Eigen::all, there);
  const Vector part = weight(there);
  const Points rising = steep(Eigen::all, there);
  // of potentials and of their slopes along x and y: a share (first column), and its change with the place along x and y
  std::array<Matrix, 3> weights{Matrix(3, beside.cols()), Matrix::Zero(3, beside.cols()), Matrix::Zero(3, beside.cols())};
  weights[0] << part.transpose(), rising;
  for (Index p = 0; p < beside.cols(); ++p) {
    const Eigen::Vector2d at = beside.col(p).cwiseMax(-half).cwiseMin(half);
    Index nearest;
    const double distance = std::sqrt((t.centres.colwise() - at).colwise().squaredNorm().minCoeff(&nearest));
    Eigen::Matrix2d moves = Eigen::Matrix2d::Identity();
    beside.col(p) = at;
    const Part middle = outside_disc(distance, t.radius, radius * cut.radii[there[p]]).middle;
    const double rim = kRim * t.radius, to = std::max(middle.value, rim);
    if (to != distance) {  // in the middle of an electrode these do not know which way they move
      const Eigen::Vector2d out = (at - t.centres.col(nearest)) / std::max(distance, 1e-12);
      beside.col(p) = t.centres.col(nearest) + to * out;
      moves = to / std::max(distance, 0.1 * t.radius) * (moves - out * out.transpose());
      if (to > rim) moves += middle.by_distance * out * out.transpose();
    }
    for (int d = 0; d < 2; ++d) weights[1 + d].col(p).tail<2>() = part[p] * moves.col(d);
  }
  const Index n = count();
  const Matrix sums = sheet_->potentials_sum(beside, weights);
  const Eigen::RowVector3d parts(part.sum(), rising.row(0).sum(), rising.row(1).sum());
  found = t.inverse.topLeftCorner(n, n) * sums + t.inverse.topRightCorner(n, 1) * parts;
  found.row(which) += Eigen::RowVector3d(1, 0, 0) - parts;
  return true;
}

void RowModel::shares(const Discs& contacts, Matrix& share, std::array<Matrix, 2>& slopes) const {
  const Index n = count(), k = contacts.cols();
  share.resize(n, k);
  for (Matrix& each : slopes) each.resize(n, k);
  Matrix own;
  std::array<Matrix, 2> steep;
  Eigen::Matrix<double, Eigen::Dynamic, 3> rim;
  for (Index i = 0; i < k; ++i) {
    const Points place = contacts.block<2, 1>(0, i);
    const double radius = std::exp(contacts(3, i));
    if (at_rim(place, radius, rim)) {
      share.col(i) = rim.col(0), slopes[0].col(i) = rim.col(1), slopes[1].col(i) = rim.col(2);
    } else {
      sheet_->even_discs_at(place, radius, own, steep);
      share.col(i) = own, slopes[0].col(i) = steep[0], slopes[1].col(i) = steep[1];
    }
  }
  if (!added_.size()) return;
  const Around around(sheet_->tables().coarse, contacts.topRows<2>());
  const Matrix added = added_(Eigen::all, around.nodes);
  share += around.values(added);
  slopes[0] += around.along_x(added, 0, k), slopes[1] += around.along_y(added, 0, k);
}

Matrix RowModel::shares_added(const Points& places) const {
  if (!added_.size()) return Matrix::Zero(count(), places.cols());
  const Around around(sheet_->tables().coarse, places);
  return around.values(added_(Eigen::all, around.nodes));
}

const Eigen::MatrixXf& RowModel::by_sheet(const Eigen::Vector2d& place) const {
  const Tables& t = sheet_->tables();
  const Eigen::Vector2d cell = place * kCells / t.pitch;
  const std::pair<int, int> key(int(std::lround(cell.x())), int(std::lround(cell.y())));
  const auto found = by_sheet_.find(key);
  if (found != by_sheet_.end()) return found->second;
  if (by_sheet_.size() >= kMost) by_sheet_.clear();
  const Stencil stencil = t.coarse.at(key.first * t.pitch / kCells, key.second * t.pitch / kCells);
  Matrix out = Matrix::Zero(count(), modes());
  for (int k = 0; k < 16; ++k)
    out += stencil.weights[k] * Eigen::Map<const Matrix>(t.share_change.col(stencil.nodes[k]).data(), count(), modes());
  return by_sheet_[key] = out.cast<float>();
}

bool RowModel::alike(const Discs& one, const Discs& other, double place, double size) const {
  if (one.cols() != other.cols()) return false;
  const Discs apart = (one - other).cwiseAbs();
  return (apart.topRows<2>().array() < place * sheet_->tables().pitch).all() && (apart.row(2).array() < kAsStrong).all() &&
         (apart.row(3).array() <= size).all();
}

Matrix RowModel::mutual(const Discs& contacts) const {
  if (!contacts.allFinite()) throw BadInput("contacts of a row are not finite");
  const Index k = contacts.cols();
  const double reach = kScreened * sheet_->tables().pitch;
  Eigen::ArrayXXd near = Eigen::ArrayXXd::Zero(k, k);
  for (Index i = 0; i < k; ++i)
    for (Index j = 0; j < i; ++j)
      if ((contacts.block<2, 1>(0, i) - contacts.block<2, 1>(0, j)).norm() < reach) near(i, j) = near(j, i) = 1;
  if (near.isZero(0.0)) return {};
  if (!alike(mutual_.first, contacts, kThere, 0.0)) {
    const Matrix between = mutual_impedance(*sheet_, contacts.topRows<2>(), contacts.row(3).transpose().array().exp());
    mutual_ = {contacts, (near * between.array().max(0.0)).matrix()};
  }
  return mutual_.second;
}

Row RowModel::idle() const {
  Row row;
  const Index n = count();
  row.readings = sensor_.offset;
  row.variance = sensor_.alone;
  row.driven = row.lifted = Vector::Zero(n);
  row.ratio = Vector::Ones(n);
  row.own = std::numeric_limits<double>::infinity();
  row.changes = Matrix::Zero(n, modes());
  row.common = Matrix::Zero(n, 3);
  row.spread.resize(n, 0), row.matrix.resize(0, 0);
  return row;
}

Row RowModel::row(const Discs& contacts, Index ground, const Vector& shift, const Matrix& mutual, const Read& valid) const {
  const Index n = count(), k = contacts.cols(), modes = this->modes();
  if (ground < 0 || ground >= n || shift.size() != modes + n || Index(valid.size()) != n || (mutual.size() && (mutual.rows() != k || mutual.cols() != k)))
    throw BadInput("a row does not fit the electrodes, or the contacts");
  if (!contacts.allFinite()) throw BadInput("contacts of a row are not finite");
  if (!k && !wide_.cols()) return idle();
  Row row;
  Matrix share(n, 0);
  std::array<Matrix, 2> slopes{share, share};
  if (k) shares(contacts, share, slopes);
  Matrix between = (-contacts.row(2)).array().exp().matrix().asDiagonal();
  if (mutual.size()) between += mutual;
  row.spread = impedance_ * share;
  row.matrix = between + row.spread.transpose() * share;
  Vector z = impedance_.col(ground);
  row.lifted = Vector::Zero(n);
  if (k) {
    Matrix right = Matrix::Ones(k, 2);
    right.col(0) = row.spread.row(ground);
    const Matrix found = solved(row.matrix, right);
    z -= row.spread * found.col(0);
    if (!wide_.cols()) {
      const double lifting = found.col(1).sum();
      if (!(lifting > 0)) throw std::domain_error("contacts conduct less than nothing");
      row.lifted = (1.0 - (row.spread * found.col(1)).array()) / std::sqrt(lifting);
      z += row.lifted * row.lifted[ground];
    }
  }
  const double within = within_[ground];
  row.own = z[ground] + within + sensor_.resistance[ground];
  row.ratio = z / row.own;
  row.driven = 1.0 - row.ratio.array();
  row.driven[ground] -= within / row.own;
  Kept& kept = kept_[ground];
  if (kept.valid != valid || !alike(kept.contacts, contacts, kAlike, kAsStrong))
    kept = derivatives(contacts, ground, row, share, slopes, between, valid);
  row.changes = kept.changes;
  row.variance = sensor_.alone.array() + kInexact * kInexact * row.driven.array().square() + kept.variance.array();
  row.common.resize(n, 3);
  row.common << row.ratio * (sensor_.resistance_deviation[ground] / row.own), kept.deviation;
  row.common = sensor_.gain.asDiagonal() * row.common;
  row.readings = (sensor_.gain + shift.tail(n)).cwiseProduct(row.driven + kept.moved) + sensor_.offset;
  row.readings.noalias() += row.changes.rightCols(modes) * shift.head(modes);
  return row;
}

RowModel::Kept RowModel::derivatives(const Discs& contacts, Index ground, const Row& row, const Matrix& share,
                                     std::array<Matrix, 2> slopes, const Matrix& between, const Read& valid) const {
  const Index n = count(), k = contacts.cols(), modes = this->modes();
  Discs inside = contacts;
  for (int d = 0; d < 2; ++d) inside.row(d) = contacts.row(d).cwiseMax(-inside_[d]).cwiseMin(inside_[d]);
  Matrix unused;
  if (inside != contacts) shares(inside, unused, slopes);
  Matrix impedance = impedance_ - row.own * row.ratio * row.ratio.transpose() + row.lifted * row.lifted.transpose();
  Matrix fed(n, 0);
  if (k) {
    impedance.noalias() -= row.spread * solved(row.matrix, row.spread.transpose());
    fed = solved(between, share.transpose()).transpose();
  }
  const Vector current = fed.transpose() * row.ratio;
  Matrix by_contact = Matrix::Zero(n, kState * k);
  for (Index i = 0; i < k; ++i) {
    for (int d = 0; d < 2; ++d)
      by_contact.col(kState * i + d) = current[i] * slopes[d].col(i) + slopes[d].col(i).dot(row.ratio) * fed.col(i);
    by_contact.col(kState * i + 4) = std::exp(-contacts(2, i)) * current[i] * fed.col(i);
  }
  Kept kept{contacts, valid, Matrix(n, kState * k + modes), Vector(), Vector::Zero(n), Eigen::MatrixX2d(n, 2)};
  kept.changes.leftCols(kState * k).noalias() = impedance * by_contact;
  const Eigen::VectorXf single = row.ratio.cast<float>();
  Eigen::MatrixXf currents(n, modes);
  Eigen::Map<Eigen::VectorXf>(currents.data(), n * modes).noalias() = change_.transpose() * single;
  for (Index i = 0; i < k; ++i) {
    const Eigen::MatrixXf& moved = by_sheet(contacts.block<2, 1>(0, i));
    currents += float(current[i]) * moved;
    currents.noalias() += fed.col(i).cast<float>() * (single.transpose() * moved);
  }
  kept.changes.rightCols(modes) = (impedance.cast<float>() * currents).cast<double>();
  const double rate = sheet_->tables().inside[ground] / row.own;
  kept.changes.rightCols<1>() += rate * row.ratio;
  kept.changes(ground, kState * k + modes - 1) -= rate;
  Vector sees = sensor_.gain;
  for (Index e = 0; e < n; ++e)
    if (!valid[e]) sees[e] = 0.0;
  kept.changes = sees.asDiagonal() * kept.changes;
  // where electrodes lie (forward.hpp): columns are those of the one that is read, ways those of the grounded one
  kept.moved = Vector::Zero(n);
  const std::array<Matrix, 2> kernel = sheet_->kernel(contacts.topRows<2>());
  for (int d = 0; d < 2; ++d) {
    const Matrix patches = kernel[d] - sheet_->tables().between[d] * share;
    Vector columns = patches * current - fields_[d] * row.ratio;
    const double at_ground = -columns[ground];
    columns[ground] = 0.0;
    const Vector taken = fields_[d].row(ground).transpose() - fed * patches.row(ground).transpose();
    Vector ways = at_ground * row.ratio - (impedance * taken - row.ratio * taken.dot(impedance.col(ground))) / row.own;
    ways[ground] -= at_ground;
    kept.moved += sensor_.aside.col(d).cwiseProduct(columns) + sensor_.aside(ground, d) * ways;
    kept.variance.array() += sensor_.unsure.col(d).cwiseProduct(columns).array().square();
    kept.deviation.col(d) = sensor_.unsure(ground, d) * ways;
  }
  return kept;
}

Vector RowModel::limited(const Vector& now, const Vector& wanted, Index contacts) const {
  if (now.size() != wanted.size() || wanted.size() < kState * contacts) throw BadInput("states of a row differ in size");
  const Tables& t = sheet_->tables();
  const double reach = kReach * t.pitch;
  double longest = 1.0;
  for (Index i = 0; i < contacts; ++i) {
    const auto way = wanted.segment<kState>(kState * i) - now.segment<kState>(kState * i);
    longest = std::max({longest, std::abs(way[0]) / reach, std::abs(way[1]) / reach, std::abs(way[4]) / kReachStrength});
  }
  Vector out = longest == 1.0 ? wanted : Vector(now + (wanted - now) / longest);
  for (Index i = 0; i < contacts; ++i) {
    auto own = out.segment<kState>(kState * i);
    for (int d = 0; d < 2; ++d) {  // what reaches the rim goes no further
      const double half = t.outline.size[d] / 2;
      if (std::abs(own[d]) > half && own[d] * own[2 + d] > 0) own[2 + d] = 0.0;
      own[d] = std::min(std::max(own[d], -half), half);
    }
    own[4] = std::min(std::max(own[4], least_), most_);
  }
  return out;
}

RowFit RowModel::idle_fit(const Vector& mean, const Vector& readings, const Read& valid) const {
  const Index n = count();
  if (readings.size() != n || Index(valid.size()) != n) throw BadInput("a row does not fit the electrodes");
  RowFit fit;
  fit.row = idle(), fit.mean = mean, fit.misfit = Vector::Zero(n), fit.root = Matrix::Zero(n, n);
  for (Index e = 0; e < n; ++e) {
    if (valid[e]) fit.misfit[e] = readings[e] - fit.row.readings[e];
    fit.root(e, e) = std::sqrt(valid[e] ? fit.row.variance[e] : kNotRead);
    fit.chi_squared += std::pow(fit.misfit[e] / fit.root(e, e), 2);
  }
  return fit;
}

RowFit RowModel::fit(const Vector& before, const Eigen::Ref<const Matrix>& covariance, const Vector& sizes, const Matrix& mutual,
                     const Vector& readings, const Read& valid, Index ground, int steps, const Vector* start, bool learns) const {
  const Index k = sizes.size(), n = count(), gains = before.size() - n, sensor = kState * k;
  if (gains != sensor + modes() || covariance.rows() != before.size() || covariance.cols() != before.size() ||
      (start && start->size() != before.size()))
    throw BadInput("what is believed does not fit the contacts and the sensor");
  if (!k && !wide_.cols()) return idle_fit(before, readings, valid);
  if (readings.size() != n || Index(valid.size()) != n) throw BadInput("a row does not fit the electrodes");
  Vector is_read(n), unread(n);
  for (Index e = 0; e < n; ++e) is_read[e] = valid[e] ? 1.0 : 0.0, unread[e] = valid[e] ? 0.0 : kNotRead;
  RowFit fit;
  fit.mean = start ? *start : before;
  for (int step = 0; step < steps; ++step) {
    Discs contacts(4, k);
    for (Index i = 0; i < k; ++i) contacts.col(i) << fit.mean.segment<2>(kState * i), fit.mean[kState * i + 4], sizes[i];
    fit.row = row(contacts, ground, fit.mean.tail(modes() + n), mutual, valid);
    const Matrix& changes = fit.row.changes;
    const Vector driven = fit.row.driven.cwiseProduct(is_read);
    const Matrix common = is_read.asDiagonal() * fit.row.common;
    fit.misfit = (readings - fit.row.readings).cwiseProduct(is_read);
    if (step || start) {
      const Vector way = before - fit.mean;
      fit.misfit -= changes * way.head(gains) + driven.cwiseProduct(way.tail(n));
    }
    // each gain changes its own reading alone
    fit.spread.noalias() = changes * covariance.topRows(gains);
    fit.spread.noalias() += driven.asDiagonal() * covariance.bottomRows(n);
    Matrix scatter = fit.spread.leftCols(gains) * changes.transpose();
    scatter.noalias() += fit.spread.rightCols(n) * driven.asDiagonal();
    scatter.noalias() += common * common.transpose();
    scatter.diagonal() += fit.row.variance + unread;
    fit.root = lower(scatter);
    const auto root = fit.root.triangularView<Eigen::Lower>();
    const Vector along = root.solve(fit.misfit);
    fit.shares = learns ? fit.spread : Matrix(fit.spread.leftCols(sensor));
    root.solveInPlace(fit.shares);
    fit.chi_squared = along.squaredNorm();
    Vector wanted = before;
    wanted.head(fit.shares.cols()).noalias() += fit.shares.transpose() * along;
    const Vector taken = limited(fit.mean, wanted, k);
    const Vector moved = (taken - fit.mean).head(sensor);
    fit.mean = taken;
    const Vector known = covariance.diagonal().head(sensor) - fit.shares.leftCols(sensor).colwise().squaredNorm().transpose();
    if ((moved.array().square() <= kSettled * kSettled * known.array()).all()) break;
  }
  return fit;
}

double RowFit::cost() const { return chi_squared + 2 * root.diagonal().array().log().sum(); }

void RowFit::correct(Eigen::Ref<Matrix> covariance) const {
  const Index own = shares.cols(), all = mean.size();
  if (!spread.size()) return;  // nothing was learned at all
  if (covariance.rows() != all || covariance.cols() != all) throw BadInput("a covariance does not fit what was fitted");
  Eigen::Ref<Matrix> known = covariance.topLeftCorner(own, own);
  known.selfadjointView<Eigen::Lower>().rankUpdate(shares.transpose(), -1.0);
  known.triangularView<Eigen::StrictlyUpper>() = known.transpose();
  if (own == all) return;
  const Matrix told = root.triangularView<Eigen::Lower>().transpose().solve(shares).transpose() * spread.rightCols(all - own);
  covariance.topRightCorner(own, all - own) -= told;
  covariance.bottomLeftCorner(all - own, own) -= told.transpose();
}

}  // namespace tomotactile
