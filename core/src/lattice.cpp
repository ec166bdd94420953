#include "tomotactile/lattice.hpp"

#include <algorithm>
#include <cmath>

namespace tomotactile {
namespace {

using Four = Eigen::Vector4d;

Four keys(double t) {
  const double t2 = t * t, t3 = t2 * t;
  return Four(-t + 2 * t2 - t3, 2 - 5 * t2 + 3 * t3, t + 4 * t2 - 3 * t3, -t2 + t3) / 2;
}

Four keys_slope(double t) {
  const double t2 = t * t;
  return Four(-1 + 4 * t - 3 * t2, -10 * t + 9 * t2, 1 + 8 * t - 9 * t2, -2 * t + 3 * t2) / 2;
}

}  // namespace

Stencil Lattice::at(double x, double y) const {
  const double place[2] = {x, y};
  Four value[2], slope[2];
  int low[2];
  for (int axis = 0; axis < 2; ++axis) {
    const double at = (place[axis] - start[axis]) / step[axis];
    // NaN and infinity end at the rim, as any place beyond it does
    const double highest = counts[axis] - 3;
    const double floor = std::floor(at);
    low[axis] = floor > 1 ? int(std::min(floor, highest)) : 1;
    const double part = at > low[axis] ? std::min(at - low[axis], 1.0) : 0.0;
    value[axis] = keys(part);
    slope[axis] = keys_slope(part) / step[axis];
  }
  Stencil out;
  const int first = (low[0] - 1) * counts.y() + low[1] - 1;
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      const int k = 4 * i + j;
      out.nodes[k] = first + i * counts.y() + j;
      out.weights[k] = value[0][i] * value[1][j];
      out.along_x[k] = slope[0][i] * value[1][j];
      out.along_y[k] = value[0][i] * slope[1][j];
    }
  }
  return out;
}

Around::Around(const Lattice& lattice, const Points& places) : stencils_(places.cols()) {
  std::vector<int> number(lattice.points(), -1);
  for (Index p = 0; p < places.cols(); ++p) {
    stencils_[p] = lattice.at(places(0, p), places(1, p));
    for (int node : stencils_[p].nodes)
      if (number[node] < 0) number[node] = 0, nodes.push_back(node);
  }
  std::sort(nodes.begin(), nodes.end());
  for (std::size_t m = 0; m < nodes.size(); ++m) number[nodes[m]] = int(m);
  for (Stencil& stencil : stencils_)
    for (int& node : stencil.nodes) node = number[node];
}

Matrix Around::read(const Matrix& at_nodes, Index first, Index count, std::array<double, 16> Stencil::*weights) const {
  Matrix out = Matrix::Zero(at_nodes.rows(), count);
  for (Index p = 0; p < count; ++p) {
    const Stencil& stencil = stencils_[first + p];
    for (int k = 0; k < 16; ++k) out.col(p) += (stencil.*weights)[k] * at_nodes.col(stencil.nodes[k]);
  }
  return out;
}

Matrix Around::spread(const Matrix& at_places) const {
  Matrix out = Matrix::Zero(at_places.rows(), nodes.size());
  for (std::size_t p = 0; p < stencils_.size(); ++p)
    for (int k = 0; k < 16; ++k) out.col(stencils_[p].nodes[k]) += stencils_[p].weights[k] * at_places.col(p);
  return out;
}

Matrix Around::spread(const std::array<Matrix, 3>& at_places) const {
  Matrix out = Matrix::Zero(at_places[0].rows(), nodes.size());
  for (std::size_t p = 0; p < stencils_.size(); ++p) {
    const Stencil& stencil = stencils_[p];
    for (int k = 0; k < 16; ++k)
      out.col(stencil.nodes[k]) += stencil.weights[k] * at_places[0].col(p) + stencil.along_x[k] * at_places[1].col(p) +
                                   stencil.along_y[k] * at_places[2].col(p);
  }
  return out;
}

}  // namespace tomotactile
