#include "tomotactile/births.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "tomotactile/linear_algebra.hpp"

namespace tomotactile {
namespace {

constexpr double kFading = 0.75;    // weight that the rows before keep from row to row: four rows
constexpr double kApart = 1.0;      // spacings between places that are tried as starts
constexpr std::size_t kStarts = 3;  // of fits, the likeliest place and others of nearly as large a gain
constexpr double kNearly = 0.5;     // of the largest gain
constexpr double kLeast = 1e-6;     // of the largest admittance of an electrode: that of a contact at least
constexpr double kBare = 1e-3;      // of the voltage that drives a contact: what a nearly bare one leaves to its resistance
constexpr double kTiny = 1e-300, kNoOhm = 1e-12;  // in the place of 0 where a number is divided by; ohm

}  // namespace

Births::Births(std::shared_ptr<const Sheet> sheet, Points places, double radius, double threshold)
    : sheet_(std::move(sheet)), places_(std::move(places)), threshold_(threshold),
      limit_(sheet_->tables().admittance.diagonal().maxCoeff()) {
  if (!places_.cols() || !places_.allFinite() || !(radius > 0)) throw BadInput("places where contacts may begin are needed");
  std::array<Matrix, 2> unused;
  sheet_->even_discs_at(places_, radius, even_, unused);
}

Births::Gains Births::look(const std::shared_ptr<const RowModel>& model, const RowFit& fit, Index ground, Matrix& sums) const {
  if (model_ != model) {
    shares_ = even_ + model->shares_added(places_);
    spread_ = model->impedance() * shares_;
    model_ = model;
  }
  const Row& row = fit.row;
  Matrix shape = spread_;
  if (std::isinf(row.own)) {  // nothing touches: what is common to all electrodes is infinite and cancels
    const Vector z = model->impedance().col(ground);
    shape.colwise() -= z;
    shape.rowwise() -= ((z.transpose() * shares_).array() - z[ground]).matrix();
  } else {  // M = Zb - what contacts, the grounded electrode and the floating sheet take
    shape.noalias() -= row.own * row.ratio * (row.ratio.transpose() * shares_);
    shape.noalias() += row.lifted * (row.lifted.transpose() * shares_);
    if (row.matrix.size()) shape.noalias() -= row.spread * solved(row.matrix, row.spread.transpose() * shares_);
  }
  const auto root = fit.root.triangularView<Eigen::Lower>();
  const Matrix white = root.solve(model->gain().asDiagonal() * shape);
  const Vector left = root.solve(fit.misfit);
  const Eigen::ArrayXd own = shares_.cwiseProduct(shape).colwise().sum().transpose();
  const Eigen::ArrayXd driven = (shares_.transpose() * row.ratio).array(), along = (white.transpose() * left).array();
  const Eigen::ArrayXd power = white.colwise().squaredNorm().transpose().array().max(kTiny);
  const Eigen::ArrayXd most = (driven / own.max(kNoOhm)).max(0.0);  // of a bare conductor
  const Eigen::ArrayXd alpha = (along / power).max(0.0).min(most);
  sums *= kFading;
  sums.col(0) += along.matrix(), sums.col(1) += power.matrix();
  const Eigen::ArrayXd several = sums.col(0).array().max(0.0).square() / sums.col(1).array().max(kTiny);
  const Eigen::ArrayXd rest = (driven - alpha * own).max(kBare * driven);
  Gains out;
  out.gains = (2 * alpha * along - alpha.square() * power).max(several).matrix();
  out.conductances = (alpha / rest.max(kNoOhm)).max(kLeast * limit_).min(limit_).matrix();
  if (!out.gains.allFinite()) throw std::domain_error("gains of a new contact are not finite");
  out.any = out.gains.maxCoeff() >= threshold_;
  return out;
}

std::vector<Eigen::Vector3d> Births::starts(const Gains& of) const {
  std::vector<Index> order(places_.cols());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](Index a, Index b) { return of.gains[a] > of.gains[b]; });
  const double apart = kApart * sheet_->tables().pitch;
  std::vector<Eigen::Vector3d> out;
  for (Index each : order) {
    if (out.size() == kStarts || !(of.gains[each] >= kNearly * of.gains[order[0]])) break;
    const bool other = std::all_of(out.begin(), out.end(), [&](const Eigen::Vector3d& found) {
      return (places_.col(each) - found.head<2>()).norm() > apart;
    });
    if (other) out.emplace_back(places_(0, each), places_(1, each), std::log(of.conductances[each]));
  }
  return out;
}

}  // namespace tomotactile
