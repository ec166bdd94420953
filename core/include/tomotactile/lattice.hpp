// Values between the points of a rectangular lattice by cubic convolution.
//
// With t the position between the middle ones of four neighbours, their weights are [1 t t^2 t^3] K (Keys 1981, IEEE
// Trans. Acoust. 29, 1153, equation 4 with a = -1/2); in the plane the product of those along both axes.
#pragma once

#include "tomotactile/types.hpp"

namespace tomotactile {

struct Stencil {
  std::array<int, 16> nodes;
  std::array<double, 16> weights;
  std::array<double, 16> along_x, along_y;  // weights of the slopes, 1/m
};

struct Lattice {
  Eigen::Vector2d start, step;  // first point and distances, m
  Eigen::Vector2i counts;       // points along x and y; y runs fastest

  Index points() const { return Index(counts.x()) * counts.y(); }
  Stencil at(double x, double y) const;
};

// The points of a lattice around several places, and weights to read values and slopes off there.
struct Around {
  Around() = default;
  Around(const Lattice& lattice, const Points& places);

  std::vector<int> nodes;
  Matrix weights;             // m x P
  Matrix along_x, along_y;    // m x P, of the slopes, 1/m
};

}  // namespace tomotactile
