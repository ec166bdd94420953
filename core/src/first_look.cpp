#include "tomotactile/first_look.hpp"

#include <algorithm>
#include <cmath>

#include "tomotactile/linear_algebra.hpp"

namespace tomotactile {
namespace {

constexpr int kPicks = 24;           // pixels that are picked at the most
constexpr int kSteps = 3, kLast = 8; // of sliding after a pick, and where no pick explains more
constexpr double kReach = 0.3;       // spacings that a place slides in one step at the most
constexpr double kSettled = 0.01;    // spacings: places that slide less stay
constexpr double kDamping = 1e-3;    // of the diagonal of the normal matrix of a slide
// of the sum of squares that a pick removes at least: what a point leaves of a small disc, within a spacing
constexpr double kExplained = 1e-3;
constexpr double kFurther = 0.1;     // of what is left, that one more point explains: parts of something wide explain less
constexpr double kInexact = 0.02;    // of a current: points stand for contacts of any size
constexpr int kFilling = 20;         // steps that fill in missing readings from their neighbours
constexpr double kDependent = 1e-2;  // of a column's square: what is less beside the others is rounding and errors
constexpr double kRidge = 1e-3;      // of the diagonal of the normal matrix of a linear image
constexpr double kRounding = 1e-10;  // of the diagonal of a normal matrix

// Of 5 k columns those of values and of derivatives by x and y, 3 k.
Matrix summed(const Matrix& columns) {
  const Index k = columns.cols() / 5;
  Matrix out(columns.rows(), 3 * k);
  out << columns.leftCols(k), columns.middleCols(k, k) + columns.middleCols(2 * k, k),
      columns.middleCols(3 * k, k) + columns.rightCols(k);
  return out;
}

Matrix ridged(Matrix normal, double part) {
  normal.diagonal() *= 1 + part;
  return normal;
}

}  // namespace

FirstLook::FirstLook(std::shared_ptr<const Sheet> sheet, const Matrix& admittance, const Rows& rows, const Vector& gain,
                     const Vector& offset, Points pixels, const Matrix& share, double side)
    : sheet_(std::move(sheet)), grounded_(rows.grounded), pixels_(std::move(pixels)), side_(side) {
  const Index n = sheet_->count(), scan = Index(grounded_.size());
  if (admittance.rows() != n || admittance.cols() != n || gain.size() != n || offset.size() != n || share.rows() != n ||
      share.cols() != pixels_.cols() || rows.readings.rows() != n || rows.readings.cols() != scan)
    throw BadInput("Y0, rows, channels and pixels are not of the same electrodes");
  if (!(side > 0) || !pixels_.cols() || !share.allFinite() || !gain.allFinite() || !offset.allFinite() || !admittance.allFinite())
    throw BadInput("Y0, channels and pixels must be finite");
  const auto read = rows.weights.array() > 0;
  std::vector<double> weights;
  for (Index e = 0; e < rows.weights.size(); ++e)
    if (rows.weights(e) > 0) weights.push_back(rows.weights(e));
  if (weights.empty()) throw BadInput("nothing was read");
  std::nth_element(weights.begin(), weights.begin() + weights.size() / 2, weights.end());
  ratio_ = read.select(1 - rows.readings.array(), 0.0).matrix();
  Eigen::Array<bool, Eigen::Dynamic, Eigen::Dynamic> missing = !read;
  for (Index l = 0; l < scan; ++l) {
    if (grounded_[l] < 0 || grounded_[l] >= n) throw BadInput("a row grounds an electrode that is not in use");
    ratio_(grounded_[l], l) = 1, missing(grounded_[l], l) = false;
  }
  if (!ratio_.allFinite()) throw BadInput("readings must be finite");
  if (missing.any()) {
    for (Index l = 0; l < scan; ++l) {
      const double mean = ratio_.col(l).sum() / double((!missing.col(l)).count());
      ratio_.col(l) = missing.col(l).select(mean, ratio_.col(l).array()).matrix();
    }
    for (int k = 0; k < kFilling; ++k) {
      const Matrix balanced = ratio_ - (admittance * ratio_).cwiseQuotient(admittance.diagonal().replicate(1, scan));
      ratio_ = missing.select(balanced.array(), ratio_.array()).matrix();
    }
  }
  Matrix currents = -(admittance * ratio_);
  currents = missing.select(0.0, currents.array()).matrix();
  for (Index l = 0; l < scan; ++l) currents(grounded_[l], l) = 0;
  // Noise of the readings, what is not known of the channels, and a part of the currents themselves. Rows have their
  // channels in common: of L rows, what these err by looks like a contact the less, the more there are.
  Vector variance = gain.array().square() * (1 - ratio_.array()).square().rowwise().mean() + offset.array().square();
  variance = (variance / double(scan)).array() + 1 / weights[weights.size() / 2];
  Matrix covariance = admittance * variance.asDiagonal() * admittance;
  covariance.diagonal().array() += kInexact * kInexact * currents.array().square().mean();
  metric_ = inverse_of(covariance);
  wanted_ = metric_ * currents;
  total_ = currents.cwiseProduct(wanted_).sum(), noise_ = double(currents.size());
  at_ground_.resize(scan), wanted_ground_.resize(scan);
  for (Index l = 0; l < scan; ++l) at_ground_[l] = metric_(grounded_[l], grounded_[l]), wanted_ground_[l] = wanted_(grounded_[l], l);
  all_ = columns(ratio_.transpose() * share, share);
  along_ = along(all_), power_ = squares(all_);
}

FirstLook::Columns FirstLook::columns(Matrix driven, Matrix share) const {
  Columns out;
  out.weighted = metric_ * share;
  out.local = share(grounded_, Eigen::all), out.pulled = out.weighted(grounded_, Eigen::all);
  out.driven = std::move(driven), out.share = std::move(share);
  return out;
}

Matrix FirstLook::between(const Columns& these, const Columns& others) const {
  Matrix out = (these.driven.transpose() * others.driven).cwiseProduct(these.share.transpose() * others.weighted);
  const Matrix own = these.driven.cwiseProduct(these.local), other = others.driven.cwiseProduct(others.local);
  out.noalias() -= own.transpose() * (others.driven.cwiseProduct(others.pulled) - at_ground_.asDiagonal() * other);
  out.noalias() -= these.driven.cwiseProduct(these.pulled).transpose() * other;
  return out;
}

Vector FirstLook::squares(const Columns& of) const {
  Matrix power = of.local.array().square().colwise() * at_ground_.array() - 2 * (of.local.array() * of.pulled.array());
  power.rowwise() += of.share.cwiseProduct(of.weighted).colwise().sum();
  return of.driven.cwiseAbs2().cwiseProduct(power).colwise().sum().transpose().cwiseMax(1e-300);
}

Vector FirstLook::along(const Columns& of) const {
  Matrix pulled = wanted_.transpose() * of.share;
  pulled -= wanted_ground_.asDiagonal() * of.local;
  return of.driven.cwiseProduct(pulled).colwise().sum().transpose();
}

// Where points slide to in so many steps at the most.
FirstLook::Slid FirstLook::slid(Points places, double radius, int steps) const {
  const double pitch = sheet_->tables().pitch;
  const Eigen::Array2d half = sheet_->tables().outline.size.array() / 2;
  const Index k = places.cols();
  Slid out;
  while (true) {
    Matrix share;
    std::array<Matrix, 2> slopes;
    sheet_->discs_at(places, radius, share, slopes);
    const Matrix driven = ratio_.transpose() * share, by_x = ratio_.transpose() * slopes[0], by_y = ratio_.transpose() * slopes[1];
    Matrix all_driven(driven.rows(), 5 * k), all_share(share.rows(), 5 * k);
    all_driven << driven, by_x, driven, by_y, driven;
    all_share << share, share, slopes[0], share, slopes[1];
    out.columns = columns(std::move(all_driven), std::move(all_share));
    out.normal = summed(summed(between(out.columns, out.columns)).transpose());
    const Vector goal = summed(along(out.columns).transpose()).transpose();
    out.strengths = non_negative(ridged(out.normal.topLeftCorner(k, k), kRounding), goal.head(k));
    out.along = goal - out.normal.leftCols(k) * out.strengths;
    out.left = total_ - out.strengths.dot(goal.head(k) + out.along.head(k));
    out.places = places;
    if (steps-- <= 0) return out;
    const Vector scale = out.normal.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    Matrix scaled = scale.asDiagonal() * out.normal * scale.asDiagonal();
    scaled.diagonal().array() += kDamping;
    const Vector way = scale.cwiseProduct(solved(scaled, scale.cwiseProduct(out.along)));
    double most = 0;
    for (Index i = 0; i < k; ++i) {
      if (!(out.strengths[i] > 0)) continue;
      Eigen::Vector2d step(way[k + i] / out.strengths[i], way[2 * k + i] / out.strengths[i]);
      const double length = step.norm();
      most = std::max(most, length);
      if (length > kReach * pitch) step *= kReach * pitch / length;
      places.col(i) = (places.col(i) + step).array().max(-half).min(half).matrix();
    }
    if (!(most > kSettled * pitch)) steps = 0;
  }
}

// How far what points leave falls with a contact at each pixel; `beside`: that no change of theirs explains.
Vector FirstLook::gains(const Slid& points, bool beside) const {
  Vector mine = along_, own = power_;
  if (const Index k = points.places.cols()) {
    const Matrix products = between(all_, points.columns);
    mine -= products.leftCols(k) * points.strengths;
    if (beside) {
      const Matrix taken = summed(products).transpose();
      const Matrix back = solved(ridged(points.normal, kDependent), taken);
      own = (own - taken.cwiseProduct(back).colwise().sum().transpose()).cwiseMax(kDependent * power_);
    }
  }
  Vector out = (mine.array() > 0).select(mine.array().square() / own.array(), 0.0).matrix();
  for (Index i = 0; i < points.places.cols(); ++i)
    for (Index q = 0; q < out.size(); ++q)
      if ((pixels_.col(q) - points.places.col(i)).norm() < side_ / 2) out[q] = 0;
  return out;
}

// What a further point at a pixel must explain to be none that stands for the size of one of `points` near it.
double FirstLook::beside(const Slid& points, Index pixel) const {
  if (!points.places.cols()) return kExplained * total_;
  double most = 0;
  for (Index i = 0; i < points.places.cols(); ++i)
    if ((points.places.col(i) - pixels_.col(pixel)).norm() < sheet_->tables().pitch)
      most = std::max(most, points.strengths[i] * points.strengths[i] * points.normal(i, i));
  return kExplained * most;
}

// Whether points may be a contact each: of many, those nearer to each other than a spacing are parts of something wide.
bool FirstLook::are_contacts(const Slid& points) const {
  const Index there = (points.strengths.array() > 0).count();
  if (there <= kFew) return true;
  for (Index i = 0; i < points.places.cols(); ++i)
    for (Index j = 0; j < i; ++j)
      if (points.strengths[i] > 0 && points.strengths[j] > 0 &&
          !((points.places.col(i) - points.places.col(j)).norm() > sheet_->tables().pitch))
        return false;
  return true;
}

Seen FirstLook::points(double radius) const {
  if (!(radius > 0)) throw BadInput("the radius of a contact must be above 0");
  Slid found;
  found.places.resize(2, 0), found.left = total_;
  bool settled = false;
  for (Index picks = 0; picks < sheet_->count() && found.left > noise_;) {
    Index best;
    const double explained = gains(found, settled).maxCoeff(&best);
    double enough = std::max(beside(found, best), kFurther * found.left);
    if (!settled) enough = std::max(enough, kExplained * total_);
    if (explained > enough) {
      std::vector<Index> kept;  // others conduct nothing since points came beside them
      for (Index i = 0; i < found.places.cols(); ++i)
        if (found.strengths[i] > 0) kept.push_back(i);
      Points more(2, Index(kept.size()) + 1);
      more << found.places(Eigen::all, kept), pixels_.col(best);
      Slid tried = slid(std::move(more), radius, kSteps);
      if (are_contacts(tried) && tried.strengths[Index(kept.size())] > 0) {
        found = std::move(tried), settled = false, ++picks;
        continue;
      }
    }
    if (settled || !found.places.cols()) break;
    found = slid(found.places, radius, kLast), settled = true;
  }
  return found;
}

Seen FirstLook::contacts() const {
  std::vector<int> picked;
  Matrix products(pixels_.cols(), kPicks);
  Vector strengths, left = along_;
  while (int(picked.size()) < kPicks) {
    Vector explained = (left.array() > 0).select(left.array().square() / power_.array(), 0.0).matrix();
    for (int each : picked) explained[each] = 0;
    Index best;
    if (!(explained.maxCoeff(&best) > kExplained * total_)) break;
    products.col(Index(picked.size())) = between(all_, columns(all_.driven.col(best), all_.share.col(best)));
    picked.push_back(int(best));
    const auto chosen = products.leftCols(Index(picked.size()));
    strengths = non_negative(ridged(chosen(picked, Eigen::all), kRounding), along_(picked));
    left = along_ - chosen * strengths;
  }
  return {pixels_(Eigen::all, picked), strengths, total_};
}

Vector FirstLook::image(const Matrix& share) const {
  if (share.rows() != sheet_->count()) throw BadInput("shares are not of the electrodes in use");
  const Columns all = columns(ratio_.transpose() * share, share);
  return non_negative(ridged(between(all, all), kRidge), along(all));
}

}  // namespace tomotactile
