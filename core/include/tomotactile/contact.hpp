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

// What part of a patch lies inside a straight rim or outside a round one, taken as a disc in which those of a lattice
// make up what any rim cuts off a contact evenly; its derivatives by the distance, 1/m, and the logarithm of the radius.
struct Part {
  double value, by_distance, by_size;
};
Part inside_line(double depth, double radius);  // how deep inside, m

// Outside a round one also how far off its middle lies the centre of gravity of what is left, m.
struct Left {
  Part part, middle;
};
Left outside_disc(double distance, double rim, double radius);  // between the middles, m

}  // namespace tomotactile
