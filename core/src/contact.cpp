#include "tomotactile/contact.hpp"

#include <cmath>

namespace tomotactile {
namespace {

constexpr double kBound = 0.05;  // 1/g is bounded smoothly at this part of 1/c
constexpr double kBare = 0.005;  // 1/g of a bare conductor in parts of 1/c
constexpr int kOver = 3;         // patches to the width of a rectangle, at most
constexpr double kSquare = 0.447;  // radius of the disc whose mean log distance to itself is that of a square, sides

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

Beyond::Beyond(double depth) {
  const double inside = std::min(std::max(depth + 0.5, 0.0), 1.0);
  part = inside * inside * (3 - 2 * inside), slope = 6 * inside * (1 - inside);
}

}  // namespace tomotactile
