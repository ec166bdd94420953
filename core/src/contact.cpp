#include "tomotactile/contact.hpp"

#include <cmath>

namespace tomotactile {
namespace {

constexpr double kBound = 0.05;  // 1/g is bounded smoothly at this part of 1/c
constexpr double kBare = 0.005;  // 1/g of a bare conductor in parts of 1/c
constexpr int kOver = 3;         // patches to the width of a rectangle, at most
constexpr double kSquare = 0.447;  // radius of the disc whose mean log distance to itself is that of a square, sides
// radii of a patch to the disc whose overlap with a straight rim, summed over a lattice of squares, has no ripple: 0.61
// sides, the first zero of J1(2 pi r)
constexpr double kReach = 0.6098 / kSquare;
constexpr double kNothing = 1e-6;  // of a patch: what is left does not matter, and its centre of gravity is rounding

using Shape = std::array<Eigen::Matrix2d, 4>;  // a map of the unit disc, m, and its derivatives by ln a, p, q

Shape ellipse(double p, double q, double radius) {
  const double size = std::hypot(p, q);
  const bool small = size < 1e-4;
  const double ratio = small ? 1 + size * size / 6 : std::sinh(size) / size;
  const double slope = small ? 1.0 / 3 : (std::cosh(size) - ratio) / (size * size);  // of ratio, by size, over size
  Eigen::Matrix2d turn, by_p, by_q;
  turn << p, q, q, -p;
  by_p << 1, 0, 0, -1;
  by_q << 0, 1, 1, 0;
  const Eigen::Matrix2d one = Eigen::Matrix2d::Identity(), shape = std::cosh(size) * one + ratio * turn;
  return {radius * shape, radius * shape, radius * (p * (ratio * one + slope * turn) + ratio * by_p),
          radius * (q * (ratio * one + slope * turn) + ratio * by_q)};
}

// The same but that what it stretches is turned as well, so that the sides of a square stay at right angles.
Shape rectangle(double p, double q, double radius) {
  const double size = std::max(std::hypot(p, q), 1e-6), angle = std::atan2(q, p) / 2;
  const Eigen::Vector2d way(std::cos(angle), std::sin(angle)), aside(-std::sin(angle), std::cos(angle));
  const double longer = std::exp(size), shorter = std::exp(-size);
  Eigen::Matrix2d shape, by_size, by_angle;
  shape << longer * way, shorter * aside;
  by_size << longer * way, -shorter * aside;
  by_angle << longer * aside, -shorter * way;
  by_size /= size;
  by_angle /= 2 * size * size;
  return {radius * shape, radius * shape, radius * (p * by_size - q * by_angle), radius * (q * by_size + p * by_angle)};
}

// The square whose area is that of the unit disc, `along` patches by three, or by as many if they are fewer.
Cut square(int along) {
  const double side = std::sqrt(kPi);
  const int over = std::min(along, kOver), count = along * over;
  Cut cut{Points(2, count), Vector::Constant(count, 1.0 / count),
          Vector::Constant(count, kSquare * side / std::sqrt(double(count)))};
  for (int j = 0; j < over; ++j)
    for (int i = 0; i < along; ++i)
      cut.points.col(j * along + i) << side * ((i + 0.5) / along - 0.5), side * ((j + 0.5) / over - 0.5);
  return cut;
}

}  // namespace

Form::Form(const Tables& tables, const Eigen::Matrix<double, 6, 1>& contact, int across) {
  if (across == 0 || across >= int(tables.discs.size()) || across < -1024)
    throw BadInput("a contact cannot be " + std::to_string(across) + " patches wide");
  const Cut cut = across > 0 ? tables.discs[across] : square(-across);
  const double radius = std::exp(contact[kRadius]);
  const Shape shape = across > 0 ? ellipse(contact[kStretch], contact[kShear], radius)
                                 : rectangle(contact[kStretch], contact[kShear], radius);
  places = (shape[0] * cut.points).colwise() + contact.head<2>();
  radii = radius * cut.radii;
  area = cut.area;
  moves[0] = moves[1] = Points::Zero(2, places.cols());
  moves[0].row(0).setOnes();
  moves[1].row(1).setOnes();
  for (int k = 0; k < 3; ++k) moves[2 + k] = shape[1 + k] * cut.points;
}

Eigen::Matrix2d stretch(const Eigen::Matrix<double, 6, 1>& contact) {
  return ellipse(contact[kStretch], contact[kShear], std::exp(contact[kRadius]))[0];
}

Conductance::Conductance(double strength, double mean) {
  const double way = std::exp(-strength), rest = (way - mean) / (kBound * way), small = std::exp(-std::abs(rest));
  const double slope = (rest > 0 ? 1.0 : small) / (1 + small);
  const double left = way * (kBound * (std::max(rest, 0.0) + std::log1p(small)) + kBare);
  value = 1 / left, by_strength = 1 + slope * mean / left, by_mean = slope / left;
}

Part inside_line(double depth, double radius) {
  const double reach = kReach * radius, t = std::min(std::max(depth / reach, -1.0), 1.0), half = std::sqrt(1 - t * t);
  return {0.5 + (t * half + std::asin(t)) / kPi, 2 * half / (kPi * reach), -2 * t * half / kPi};
}

// One less the lens that two discs share, in parts of the patch. The lens is two segments; its first moment about the
// middle of the rim is the distance times the segment of the patch alone: those of the halves of the chord cancel.
Left outside_disc(double distance, double rim, double radius) {
  const double reach = kReach * radius;
  if (distance >= rim + reach) return {{1, 0, 0}, {distance, 1, 0}};
  if (distance <= rim - reach) return {{0, 0, 0}, {rim, 0, 0}};
  const double ratio = rim / reach;
  if (distance <= reach - rim) {
    const double part = 1 - ratio * ratio;
    return {{part, 0, 2 * ratio * ratio}, {distance / part, 1 / part, -2 * distance * ratio * ratio / (part * part)}};
  }
  const auto angle = [](double cosine) { return std::acos(std::min(std::max(cosine, -1.0), 1.0)); };
  const double along = (distance * distance + reach * reach - rim * rim) / (2 * distance);  // to the chord
  const double half = std::sqrt(std::max(reach * reach - along * along, 0.0)), scale = 1 / (kPi * reach * reach);
  const double mine = angle(along / reach), theirs = angle((distance - along) / rim);
  const double segment = scale * (reach * reach * mine - along * half);
  const double lens = scale * (reach * reach * mine + rim * rim * theirs - distance * half);
  const Part left{1 - lens, scale * 2 * half, 2 * (lens - mine / kPi)};
  if (left.value < kNothing) return {left, {rim, 0, 0}};
  const double to = distance * (1 - segment) / left.value;
  const double by_distance = -scale * 2 * half * (1 - along / distance);
  const double by_size = 2 * mine / kPi - 2 * segment - scale * 2 * half * reach * reach / distance;
  return {left,
          {to, (1 - segment - distance * by_distance - to * left.by_distance) / left.value,
           -(distance * by_size + to * left.by_size) / left.value}};
}

}  // namespace tomotactile
