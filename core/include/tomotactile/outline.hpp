// How deep places lie in the outline of a sheet: a rectangle, or a circle and polygons with holes.
#pragma once

#include "tomotactile/types.hpp"

namespace tomotactile {

struct Outline {
  Eigen::Vector2d size;        // of the bounding box, centred on the origin, m
  bool rectangle = true;       // without holes; else:
  double circle = 0.0;         // radius, m; 0: the first ring is the rim
  std::vector<Points> rings;   // rim (of no circle) and holes, closed

  // Depth of each place, m, negative outside, and its gradient, 2 x P.
  void depth(const Points& places, Vector& deep, Points& inwards) const;
};

}  // namespace tomotactile
