#include "tomotactile/touches.hpp"

#include <cmath>
#include <numeric>

namespace tomotactile {
namespace {

constexpr double kEuler = 0.57721566490153286061;
constexpr double kFar = 12.0;      // E1 is below 5e-7 from here on
constexpr double kTiny = 1e-15;    // m^2: a patch does not push itself
const double kCloud = std::exp(kEuler);

// E1(x) = int_x^inf exp(-t) / t dt for x > 0: series, and continued fraction beyond 1 (Abramowitz and Stegun 5.1.11,
// 5.1.22), to rounding.
double exponential_integral(double x) {
  if (x <= 1) {
    double term = 1, sum = 0;
    for (int k = 1; k < 40; ++k) {
      term *= -x / k;
      sum -= term / k;
      if (std::abs(term) < 1e-17 * k) break;
    }
    return -kEuler - std::log(x) + sum;
  }
  double b = x + 1, c = 1e300, d = 1 / b, h = d;
  for (int k = 1; k < 400; ++k) {
    const double a = -double(k) * k;
    b += 2;
    d = 1 / (a * d + b);
    c = b + a / c;
    h *= c * d;
    if (std::abs(c * d - 1) < 1e-16) break;
  }
  return h * std::exp(-x);
}

// exp(E1(x) + ln x), an entire function, by Hermite's cubics: to 1e-11 with steps of 12 / 2048.
class Cloud {
 public:
  Cloud() {
    for (int i = 0; i < kNodes; ++i) {
      const double x = i * kStep;
      value_[i] = i ? std::exp(exponential_integral(x)) * x : std::exp(-kEuler);
      slope_[i] = kStep * value_[i] * (i ? -std::expm1(-x) / x : 1.0);
    }
  }
  double operator()(double x) const {
    const int i = std::min(int(x / kStep), kNodes - 2);
    const double t = x / kStep - i, u = 1 - t;
    return u * u * ((1 + 2 * t) * value_[i] + t * slope_[i]) + t * t * ((3 - 2 * t) * value_[i + 1] - u * slope_[i + 1]);
  }

 private:
  static constexpr int kNodes = 2049;
  static constexpr double kStep = kFar / (kNodes - 1);
  double value_[kNodes], slope_[kNodes];
};

// The squared distance that two clouds with the mean squared radius `mutual` have for each other.
double softened(double squared, double mutual) {
  static const Cloud cloud;
  const double reach = kCloud * mutual;
  return squared < kFar * reach ? reach * cloud(squared / reach) : squared;
}

// Ways from places to another place and to its images in both rims of a rectangle, one place after the other.
struct Ways {
  const Eigen::Vector2d size;
  const Eigen::ArrayXd x, y;
  const int images;  // along each axis, itself included
  std::array<Eigen::ArrayXd, 3> across, up, wide, high;  // ways, and their squares

  Ways(const Outline& outline, const Points& from)
      : size(outline.size), x(from.row(0).transpose()), y(from.row(1).transpose()), images(outline.rectangle ? 3 : 1) {}

  void to(const Eigen::Vector2d& place) {
    const double beside[3] = {-place.x(), place.x() + size.x(), place.x() - size.x()};
    const double above[3] = {-place.y(), place.y() + size.y(), place.y() - size.y()};
    for (int k = 0; k < images; ++k) {
      across[k] = x + beside[k], wide[k] = across[k].square();
      up[k] = y + above[k], high[k] = up[k].square();
    }
  }
};

// Calls `near(i, mutual)` for each of clouds that is not far enough from one of radius `other` to be two points.
template <class Near>
void for_near(const Eigen::ArrayXd& squared, const Eigen::ArrayXd& radii, double largest, double other, Near near) {
  const double reach = kFar * kCloud / 2;
  if (squared.minCoeff() >= reach * (largest + other * other)) return;
  for (Index i = 0; i < squared.size(); ++i) {
    const double both = radii[i] * radii[i] + other * other;
    if (squared[i] < reach * both) near(i, both / 2);
  }
}

// Whether a contact differs from another in its conductance only.
bool is_in_place(Eigen::Matrix<double, 6, 1> contact, const Eigen::Matrix<double, 6, 1>& other) {
  contact[kStrength] = other[kStrength];
  return contact == other;
}

double largest_square(const Eigen::ArrayXd& radii) { return radii.size() ? radii.square().maxCoeff() : 0.0; }

// ln of the product of squared distances between clouds and to their images.
Matrix log_distances(const Outline& outline, const Points& mine, const Eigen::ArrayXd& radii, const Points& theirs,
                     const Eigen::ArrayXd& their_radii) {
  Ways ways(outline, mine);
  const double largest = largest_square(radii);
  Matrix out(mine.cols(), theirs.cols());
  Eigen::ArrayXd product, squared;
  for (Index q = 0; q < theirs.cols(); ++q) {
    ways.to(theirs.col(q));
    product.setOnes(mine.cols());
    for (int i = 0; i < ways.images; ++i)
      for (int j = 0; j < ways.images; ++j) {
        squared = ways.wide[i] + ways.high[j];
        for_near(squared, radii, largest, their_radii[q], [&](Index p, double mutual) { squared[p] = softened(squared[p], mutual); });
        product *= squared;
      }
    out.col(q) = product.log();
  }
  return out;
}

}  // namespace

Matrix mutual_impedance(const Sheet& sheet, const Points& places, const Vector& radii) {
  const Tables& t = sheet.tables();
  const Index n = sheet.count(), count = places.cols();
  const Around around(t.coarse, places);
  const Charges charges(t.induced, places);
  const Matrix potentials = sheet.potentials_at(places, charges.dipoles());
  std::vector<int> all(count);
  std::iota(all.begin(), all.end(), 0);
  Matrix out = around.values(around.values(t.smooth(around.nodes, around.nodes)).transpose());
  charges.add_between(0, count, all, out);
  const Matrix solved = (t.inverse.topLeftCorner(n, n) * potentials).colwise() + t.inverse.topRightCorner(n, 1).col(0);
  out.noalias() -= potentials.transpose() * solved;
  const Eigen::RowVectorXd constant = t.inverse.row(n).head(n) * potentials;
  out.rowwise() -= constant;
  out.array() -= t.inverse(n, n);
  out -= t.resistance / (4 * kPi) * log_distances(t.outline, places, radii.array(), places, radii.array());
  return (out + out.transpose()) / 2;
}

Touches::Touches(std::shared_ptr<const Sheet> on, Parameters parameters, std::vector<int> wide, const Vector& sheet_, Index cells,
                 const Touches* known)
    : sheet(std::move(on)), contacts(std::move(parameters)), across(std::move(wide)), coefficients(sheet_), cells_(cells) {
  if (Index(across.size()) != count()) throw BadInput("patches to the width are not given for each contact");
  if (coefficients.size() != sheet->modes()) throw BadInput("coefficients of the sheet are not as many as its modes");
  begin_.push_back(0);
  for (Index i = 0; i < count(); ++i) {
    forms_.emplace_back(sheet->tables(), contacts.col(i), across[i]);
    begin_.push_back(begin_.back() + forms_.back().area.size());
  }
  Vector area(begin_.back());
  place_.resize(2, begin_.back()), radii_.resize(begin_.back());
  for (Index i = 0; i < count(); ++i) {
    place_.middleCols(begin(i), size(i)) = forms_[i].places;
    radii_.segment(begin(i), size(i)) = forms_[i].radii;
    area.segment(begin(i), size(i)) = forms_[i].area;
  }
  if (!place_.allFinite() || !radii_.allFinite()) throw BadInput("a contact is not finite");
  place(area);
  connect(known);
  take();
}

// Places moved off electrodes and into the outline, and what part of each patch lies where.
void Touches::place(const Vector& area) {
  const Tables& t = sheet->tables();
  const Index count = place_.cols(), n = sheet->count();
  const Eigen::Array2d half = t.outline.size.array() / 2;
  const double rim = kRim * t.radius;
  Vector deep;
  Points inwards;
  t.outline.depth(place_, deep, inwards);
  moving_.resize(2, count), way_.resize(2, count), crossed_.resize(count);
  around_rim_.resize(count), off_rim_.resize(count), grown_off_.resize(count);
  electrode_.resize(count), weight.resize(count);
  on_.resize(count), off_.resize(count), steep_radius_.resize(count), rising_radius_.resize(count);
  steep_.resize(2, count), rising_.resize(2, count);
  direct = Matrix::Zero(n, this->count());
  for (Index i = 0; i < this->count(); ++i) {
    for (Index p = begin(i); p < begin_[i + 1]; ++p) {
      const Eigen::Array2d at = place_.col(p).array();
      moving_.col(p) = (at.abs() < half).cast<double>();
      place_.col(p) = at.max(-half).min(half).matrix();
      Index nearest;
      const double distance =
          std::sqrt((t.centres.colwise() - place_.col(p)).colwise().squaredNorm().minCoeff(&nearest));
      way_.col(p) = (place_.col(p) - t.centres.col(nearest)).array() / std::max(distance, 1e-12);
      electrode_[p] = t.position[nearest];
      const double radius = radii_[p];
      const Part there = inside_line(deep[p], radius);
      const auto [off, middle] = outside_disc(distance, t.radius, radius);
      const double to = std::max(middle.value, rim);
      crossed_[p] = to != distance;
      if (crossed_[p]) {
        place_.col(p) = t.centres.col(nearest) + to * way_.col(p).matrix();
        around_rim_[p] = distance > 1e-6 * t.radius ? to / distance : 0.0;
        off_rim_[p] = to > rim ? middle.by_distance : 0.0, grown_off_[p] = to > rim ? middle.by_size : 0.0;
      }
      on_[p] = there.value * area[p], off_[p] = off.value;
      weight[p] = on_[p] * off.value;
      if (electrode_[p] < n) direct(electrode_[p], i) += on_[p] * (1 - off.value);
      steep_.col(p) = area[p] * there.by_distance * inwards.col(p).array();
      steep_radius_[p] = area[p] * there.by_size;
      rising_.col(p) = off.by_distance * way_.col(p);
      rising_radius_[p] = off.by_size;
    }
  }
  covered = direct.colwise().sum().transpose();
  for (Index i = 0; i < this->count(); ++i)
    covered[i] = std::max(covered[i] + weight.segment(begin(i), size(i)).sum(), 1e-9);
}

// H and D on the even sheet, D between contacts that feel each other only.
void Touches::connect(const Touches* known) {
  const Tables& t = sheet->tables();
  const Index n = sheet->count();
  around_ = Around(t.coarse, place_);
  charges_ = Charges(t.induced, place_);
  const Matrix potentials = sheet->potentials_at(place_, charges_.dipoles());
  Vector alone = sheet->alone_at(place_);
  if (!sheet->about_even()) alone += sheet->own_added(around_);
  solved_ = (t.inverse.topLeftCorner(n, n) * potentials).colwise() + t.inverse.topRightCorner(n, 1).col(0);
  const Vector constant =
      (potentials.transpose() * t.inverse.bottomLeftCorner(1, n).transpose()).array() + t.inverse(n, n);
  field_ = sheet->field_at(contacts.topRows<2>());
  smooth_ = around_.values(t.smooth(around_.nodes, around_.nodes)).transpose();
  const Matrix smooth = around_.values(smooth_);

  find_near();
  even_ = Matrix::Zero(patches(), patches());
  bare_ = Eigen::Array<bool, Eigen::Dynamic, 1>::Constant(patches(), false);
  const double scale = -t.resistance / (4 * kPi);
  std::vector<bool> still(patches());  // those of contacts that are where they were
  if (known && known->begin_ == begin_ && known->sheet == sheet && known->cells_ == cells_) {
    for (Index i = 0; i < count(); ++i) {
      const bool same = across[i] == known->across[i] && is_in_place(contacts.col(i), known->contacts.col(i));
      std::fill_n(still.begin() + begin(i), size(i), same);
    }
    for (Index p = 0; p < patches(); ++p) {
      if (!still[p]) continue;
      bare_[p] = known->bare_[p];
      for (Index q = 0; q < patches(); ++q)
        if (still[q]) even_(q, p) = known->even_(q, p);
    }
  }
  for (Index i = 0; i < count(); ++i) {
    const Index first = begin(i), last = begin_[i + 1];
    std::vector<int> others;  // each pair of contacts once
    for (int other : near(i))
      if (other < last && !(still[first] && still[other])) others.push_back(other);
    if (others.empty()) continue;
    Matrix block = smooth(Eigen::seqN(first, size(i)), others);
    charges_.add_between(first, size(i), others, block);
    block.noalias() -= potentials.middleCols(first, size(i)).transpose() * solved_(Eigen::all, others);
    block.rowwise() -= constant(others).transpose();
    const Points mine = place_.middleCols(first, size(i)), theirs = place_(Eigen::all, others);
    const Eigen::ArrayXd radii = radii_.segment(first, size(i)).array(), their_radii = radii_(others).array();
    block += scale * log_distances(t.outline, mine, radii, theirs, their_radii);
    if (!still[first]) {
      auto own = block.rightCols(size(i));
      own.colwise() += alone.segment(first, size(i)) / 2;
      own.rowwise() += alone.segment(first, size(i)).transpose() / 2;
      own = ((own + own.transpose()) / 2).eval();
      for (Index p = 0; p < size(i); ++p) {
        bare_[first + p] = own(p, p) < 0;
        own(p, p) = std::max(own(p, p), 0.0);
      }
    }
    even_(Eigen::seqN(first, size(i)), others) = block;
    even_(others, Eigen::seqN(first, size(i))) = block.transpose();
  }
}

// Which contacts feel each other, and the groups of those that do through others.
void Touches::find_near() {
  const double reach = kScreened * sheet->tables().pitch;
  std::vector<int> group(count());
  std::iota(group.begin(), group.end(), 0);
  near_.assign(count(), {}), groups_.assign(count(), {});
  for (Index i = 0; i < count(); ++i)
    for (Index j = 0; j < count(); ++j) {
      const double apart = (contacts.block<2, 1>(0, i) - contacts.block<2, 1>(0, j)).norm();
      const double gap = apart - std::exp(contacts(kRadius, i)) - std::exp(contacts(kRadius, j));
      const bool of_shape = std::min(i, j) >= count() - cells_;
      if (i != j && !of_shape && !(gap < reach)) continue;
      for (Index p = begin(j); p < begin_[j + 1]; ++p) near_[i].push_back(int(p));
      if (group[i] == group[j]) continue;
      const int from = std::max(group[i], group[j]), to = std::min(group[i], group[j]);
      for (int& each : group) if (each == from) each = to;
    }
  for (Index i = 0; i < count(); ++i)
    for (Index p = begin(i); p < begin_[i + 1]; ++p) groups_[group[i]].push_back(int(p));
}

// What depends on the coefficients of the sheet.
void Touches::take() {
  share = solved_;
  factor_ = Eigen::ArrayXd::Ones(place_.cols());
  if (sheet->even(coefficients)) {
    impedance = even_;
  } else {
    added_ = sheet->share_added(coefficients, around_.nodes);
    share += around_.values(added_);
    const Vector field = field_ * coefficients;
    for (Index i = 0; i < count(); ++i) factor_.segment(begin(i), size(i)) = std::exp(-0.5 * field[i]);
    impedance = factor_.matrix().asDiagonal() * even_ * factor_.matrix().asDiagonal();
  }
  mean.resize(count());
  for (Index i = 0; i < count(); ++i) {
    const auto mine = weight.segment(begin(i), size(i));
    mean[i] = mine.dot(impedance.block(begin(i), begin(i), size(i), size(i)) * mine) / (covered[i] * covered[i]);
  }
}

std::shared_ptr<const Touches> Touches::with(const Vector& other, const Parameters& parameters, const std::vector<int>& wide,
                                             Index cells) const {
  bool stay = parameters.cols() == count() && wide == across && cells == cells_;
  for (Index i = 0; stay && i < count(); ++i) stay = is_in_place(parameters.col(i), contacts.col(i));
  if (!stay) return std::make_shared<Touches>(sheet, parameters, wide, other, cells, this);
  auto out = std::make_shared<Touches>(*this);
  out->contacts = parameters;
  if (other != coefficients) out->coefficients = other, out->take();
  return out;
}

std::array<Points, 5> Touches::moves(Index i) const {
  std::array<Points, 5> out = forms_[i].moves;
  for (int k = 0; k < 5; ++k) {
    Points& moves = out[k];
    moves.array() *= moving_.middleCols(begin(i), size(i));
    for (Index p = 0; p < size(i); ++p) {
      const Index at = begin(i) + p;
      if (!crossed_[at]) continue;
      const Eigen::Vector2d way = way_.col(at).matrix();
      const double off = moves.col(p).dot(way), grown = kMoving[k] == kRadius ? grown_off_[at] : 0.0;
      moves.col(p) = around_rim_[at] * (moves.col(p) - off * way) + (off_rim_[at] * off + grown) * way;
    }
  }
  return out;
}

void Touches::covered_change(Index i, Matrix& by_weight, Matrix& by_direct) const {
  by_weight.resize(size(i), 5);
  by_direct.setZero(sheet->count(), 5);
  for (int k = 0; k < 5; ++k)
    for (Index p = 0; p < size(i); ++p) {
      const Index at = begin(i) + p;
      const Eigen::Vector2d move = forms_[i].moves[k].col(p);
      double by_rim = move.dot(steep_.col(at).matrix()), by_electrode = move.dot(rising_.col(at).matrix());
      if (k == 2) by_rim += steep_radius_[at], by_electrode += rising_radius_[at];  // patches grow with the contact
      by_weight(p, k) = by_rim * off_[at] + on_[at] * by_electrode;
      if (electrode_[at] < sheet->count()) by_direct(electrode_[at], k) += by_rim * (1 - off_[at]) - on_[at] * by_electrode;
    }
}

void Touches::pressure_change(Index i, const Matrix& pressures, Matrix& by_weight, Matrix& by_direct) const {
  if (pressures.rows() != size(i)) throw BadInput("pressures are not given for each patch");
  by_weight = weight.segment(begin(i), size(i)).asDiagonal() * pressures;
  by_direct.setZero(sheet->count(), pressures.cols());
  for (Index p = 0; p < size(i); ++p) {
    const Index at = begin(i) + p;
    if (electrode_[at] < sheet->count()) by_direct.row(electrode_[at]) += on_[at] * (1 - off_[at]) * pressures.row(p);
  }
}

Slope Touches::impedance_slope(Index i) const {
  const Tables& t = sheet->tables();
  const std::vector<int>& others = near(i);
  const Index first = begin(i), count = size(i), reach = Index(others.size());
  const double scale = t.resistance / (2 * kPi);
  const Index own = std::lower_bound(others.begin(), others.end(), int(first)) - others.begin();
  Slope out;
  Matrix &slope_x = out.along_x, &slope_y = out.along_y;
  slope_x = slope_y = Matrix::Zero(count, reach);
  out.grown = Matrix::Zero(count, count);
  const Points mine = place_.middleCols(first, count);
  const std::array<Matrix, 2> dipole_slopes = t.induced.dipole_slopes(mine);
  charges_.add_slope(first, count, others, dipole_slopes, slope_x, slope_y);
  const Matrix smooth = smooth_(others, Eigen::all);
  slope_x += around_.along_x(smooth, first, count).transpose();
  slope_y += around_.along_y(smooth, first, count).transpose();
  out.steep = sheet->steep_at(mine, dipole_slopes);
  const Matrix solved = solved_(Eigen::all, others);
  slope_x.noalias() -= out.steep[0].transpose() * solved;
  slope_y.noalias() -= out.steep[1].transpose() * solved;
  const std::array<Vector, 2> alone = sheet->alone_steep_at(mine);
  const Points theirs = place_(Eigen::all, others);
  const Eigen::ArrayXd radii = radii_.segment(first, count).array(), their_radii = radii_(others).array();
  Ways ways(t.outline, mine);
  const double largest = largest_square(radii);
  Eigen::ArrayXd squared, inverse, by_x, by_y;
  for (Index q = 0; q < reach; ++q) {
    ways.to(theirs.col(q));
    by_x.setZero(count), by_y.setZero(count);
    for (int i = 0; i < ways.images; ++i)
      for (int j = 0; j < ways.images; ++j) {
        squared = ways.wide[i] + ways.high[j];
        inverse = squared.max(kTiny).inverse();
        for_near(squared, radii, largest, their_radii[q], [&](Index p, double mutual) {
          const double hidden = std::exp(-squared[p] / (kCloud * mutual));
          inverse[p] *= 1 - hidden;
          if (q >= own && q < own + count) out.grown(p, q - own) += scale * hidden;
        });
        by_x += ways.across[i] * inverse, by_y += ways.up[j] * inverse;
      }
    slope_x.col(q).array() -= scale * by_x, slope_y.col(q).array() -= scale * by_y;
  }
  slope_x.middleCols(own, count).colwise() += alone[0] / 2;
  slope_y.middleCols(own, count).colwise() += alone[1] / 2;
  Eigen::ArrayXXd factor = factor_.segment(first, count).matrix() * factor_(others).matrix().transpose();
  for (Index p = 0; p < count; ++p)
    if (bare_[first + p]) factor(p, own + p) = 0.0;
  slope_x.array() *= factor, slope_y.array() *= factor;
  out.grown.array() *= factor.middleCols(own, count);
  return out;
}

Eigen::Matrix<double, 5, 1> Touches::mean_change(Index i, const Slope& slope) const {
  const std::vector<int>& others = near(i);
  const Index own = std::lower_bound(others.begin(), others.end(), int(begin(i))) - others.begin();
  const auto mine = weight.segment(begin(i), size(i));
  Matrix by_weight, by_direct;
  covered_change(i, by_weight, by_direct);
  const Vector felt = impedance.block(begin(i), begin(i), size(i), size(i)) * mine;
  const Vector x = slope.along_x.middleCols(own, size(i)) * mine, y = slope.along_y.middleCols(own, size(i)) * mine;
  const std::array<Points, 5> moves = this->moves(i);
  Eigen::Matrix<double, 5, 1> out;
  for (int k = 0; k < 5; ++k) {
    double turned = mine.dot((moves[k].row(0).transpose().cwiseProduct(x) + moves[k].row(1).transpose().cwiseProduct(y)));
    if (kMoving[k] == kRadius) turned -= mine.dot(slope.grown * mine) / 2;
    const double found = 2 * turned + 2 * by_weight.col(k).dot(felt);
    const double parts = by_weight.col(k).sum() + by_direct.col(k).sum();
    out[k] = found / (covered[i] * covered[i]) - 2 * mean[i] * parts / covered[i];
  }
  return out;
}

std::array<Matrix, 2> Touches::share_slopes(Index i, const Slope& slope) const {
  const Index n = sheet->count();
  const auto inverse = sheet->tables().inverse.topLeftCorner(n, n);
  std::array<Matrix, 2> out{inverse.transpose() * slope.steep[0], inverse.transpose() * slope.steep[1]};
  if (!sheet->even(coefficients)) {
    out[0] += around_.along_x(added_, begin(i), size(i));
    out[1] += around_.along_y(added_, begin(i), size(i));
  }
  return out;
}

Eigen::Vector2d Touches::centre(Index i) const {
  Vector mass = weight.segment(begin(i), size(i));
  for (Index p = 0; p < size(i); ++p) {
    const Index at = begin(i) + p;
    if (electrode_[at] < sheet->count()) mass[p] += on_[at] * (1 - off_[at]);
  }
  return forms_[i].places * mass / covered[i];
}

}  // namespace tomotactile
