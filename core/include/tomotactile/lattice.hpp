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

// The points of a lattice around several places, from which values and slopes are read off there.
class Around {
 public:
  Around() = default;
  Around(const Lattice& lattice, const Points& places);

  std::vector<int> nodes;  // of the lattice, m

  // r x count at the places from `first` on, of values r x m at the nodes.
  Matrix values(const Matrix& at_nodes, Index first, Index count) const { return read(at_nodes, first, count, &Stencil::weights); }
  Matrix values(const Matrix& at_nodes) const { return values(at_nodes, 0, Index(stencils_.size())); }
  Matrix along_x(const Matrix& at_nodes, Index first, Index count) const { return read(at_nodes, first, count, &Stencil::along_x); }
  Matrix along_y(const Matrix& at_nodes, Index first, Index count) const { return read(at_nodes, first, count, &Stencil::along_y); }
  Matrix spread(const Matrix& at_places) const;  // r x m: the transpose of `values`
  Matrix spread(const std::array<Matrix, 3>& at_places) const;  // of `values`, `along_x` and `along_y` together

 private:
  std::vector<Stencil> stencils_;  // `nodes` of these count those above
  Matrix read(const Matrix& at_nodes, Index first, Index count, std::array<double, 16> Stencil::*weights) const;
};

}  // namespace tomotactile
