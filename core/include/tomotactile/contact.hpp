// A contact as a shape: an even conductance over a disc, an ellipse or a rectangle, cut into patches.
//
// A contact has the place x, y, the logarithms of the conductance c that it has as a whole, the way through the sheet
// included, and of its radius a, and two numbers p, q that stretch it: its shape is the unit disc times
//
//     a exp([[p, q], [q, -p]]),     1/c = 1/g + mean D
//
// Frames tell c and the place almost independently of the radius, g only together with it. Where 1/c comes near the
// mean of D the contact is as good as a bare conductor, and g is bounded smoothly.
#pragma once

#include "tomotactile/sheet.hpp"
#include "tomotactile/types.hpp"

namespace tomotactile {

enum { kX, kY, kStrength, kRadius, kStretch, kShear };         // parameters of a contact
constexpr int kMoving[5] = {kX, kY, kRadius, kStretch, kShear};  // those that move patches
constexpr double kLongest = 2.0;  // half the logarithm of the ratio of axes, at most

// How the patches of one contact lie: what follows from its parameters alone.
struct Form {
  Points places;
  Vector radii, area;           // m; shares of its area
  std::array<Points, 5> moves;  // of the places, by `kMoving`

  // Of an ellipse `across` patches wide; below 0: of a rectangle of the same area and stretch, so many patches long.
  Form(const Tables& tables, const Eigen::Matrix<double, 6, 1>& contact, int across);
};

// The shape of a contact as a map of the unit disc, m.
Eigen::Matrix2d stretch(const Eigen::Matrix<double, 6, 1>& contact);

// g of a contact, S, and the derivatives of ln g by ln c and by the mean of D, 1/ohm.
struct Conductance {
  double value, by_strength, by_mean;
  Conductance(double strength, double mean);  // ln c; ohm
};

// What part of a patch lies beyond a line that it is `depth` radii beyond, and its slope.
struct Beyond {
  double part, slope;
  explicit Beyond(double depth);
};

}  // namespace tomotactile
