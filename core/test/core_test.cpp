// What can be proved of the core without Python: physics of a sheet that is small enough to be written down.
#include <cmath>
#include <cstdio>
#include <limits>

#include "tomotactile/lattice.hpp"
#include "tomotactile/linear_algebra.hpp"
#include "tomotactile/outline.hpp"

using namespace tomotactile;

namespace {

int failures = 0;

void check(bool right, const char* what) {
  std::printf("%s: %s\n", right ? "ok" : "FAILED", what);
  failures += !right;
}

// Cubic convolution is exact for polynomials of the second degree, and its slopes are.
void lattice() {
  const Lattice lattice{Eigen::Vector2d(-1, -1), Eigen::Vector2d(0.1, 0.2), Eigen::Vector2i(21, 11)};
  double worst = 0, steep = 0;
  for (double x = -0.85; x < 0.8; x += 0.07)
    for (double y = -0.75; y < 0.7; y += 0.09) {
      const Stencil stencil = lattice.at(x, y);
      double value = 0, by_x = 0;
      for (int k = 0; k < 16; ++k) {
        const double u = -1 + 0.1 * (stencil.nodes[k] / 11), v = -1 + 0.2 * (stencil.nodes[k] % 11);
        value += stencil.weights[k] * (1 + u + u * v - v * v);
        by_x += stencil.along_x[k] * (1 + u + u * v - v * v);
      }
      worst = std::max(worst, std::abs(value - (1 + x + x * y - y * y)));
      steep = std::max(steep, std::abs(by_x - (1 + y)));
    }
  check(worst < 1e-12 && steep < 1e-11, "cubic convolution of a polynomial");
  for (double far : {std::nan(""), 1e300, -1e300}) {
    const Stencil stencil = lattice.at(far, far);
    for (int node : stencil.nodes) check(node >= 0 && node < lattice.points(), "a place beyond everything stays in the lattice");
  }
}

void outline() {
  Outline square;
  square.size = Eigen::Vector2d(2, 2);
  Outline polygon = square;
  polygon.rectangle = false;
  Points ring(2, 4);
  ring << -1, 1, 1, -1, -1, -1, 1, 1;
  polygon.rings.push_back(ring);
  Points places(2, 4);
  places << 0.5, 0.9, -0.2, 1.3, 0.1, -0.3, 0.7, 0.2;
  Vector deep, other;
  Points inwards, same;
  square.depth(places, deep, inwards);
  polygon.depth(places, other, same);
  check((deep - other).cwiseAbs().maxCoeff() < 1e-12 && (inwards - same).cwiseAbs().maxCoeff() < 1e-12,
        "a square is the polygon with its corners");
}

void algebra() {
  Matrix system(3, 3);
  system << 4, 1, 0, 1, 3, 1, 0, 1, 2;
  const Matrix inverse = inverse_of(system);
  check((system * inverse - Matrix::Identity(3, 3)).cwiseAbs().maxCoeff() < 1e-14, "inverse");
  bool thrown = false;
  try {
    Cholesky(-system);
  } catch (const std::domain_error&) {
    thrown = true;
  }
  check(thrown, "a matrix that is not positive definite is refused");
  Matrix flat = Matrix::Ones(2, 2);
  check((least_squares(flat, Vector::Ones(2)) - Vector::Constant(2, 0.5)).norm() < 1e-12, "least norm of a singular system");
  flat(0, 1) = std::numeric_limits<double>::infinity();
  check(least_squares(flat, Vector::Ones(2)).isZero() && !least_squares(Matrix(0, 0), Vector(0)).size(), "no solution of what is not finite");
}

}  // namespace

int main() {
  lattice();
  outline();
  algebra();
  return failures != 0;
}
