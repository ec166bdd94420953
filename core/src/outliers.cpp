#include "tomotactile/outliers.hpp"

#include <cmath>
#include <limits>

namespace tomotactile {
namespace {

constexpr double kTiny = 1e-300;  // in the place of 0 where a number is divided by, or its logarithm taken

}  // namespace

Outliers outliers(const Vector& misfit, const Matrix& root, const Read& valid, int most) {
  const Index n = misfit.size();
  if (root.rows() != n || root.cols() != n || Index(valid.size()) != n) throw BadInput("a covariance does not fit its readings");
  Outliers out;
  const double price = -2 * std::log(kWrong) - std::log(2 * kPi);
  const auto lower = root.triangularView<Eigen::Lower>();
  double widest = kTiny;
  for (Index e = 0; e < n; ++e)
    if (valid[e]) widest = std::max(widest, root.row(e).squaredNorm());
  if (Vector(lower.solve(misfit)).squaredNorm() + std::log(widest) <= price) return out;  // no reading can take more
  const Matrix inverse = lower.solve(Matrix::Identity(n, n));
  Matrix precision = inverse.transpose() * inverse;
  Vector weighted = precision * misfit;
  Read left = valid;
  while (int(out.found.size()) < most) {
    Index worst = -1;
    double gain = -std::numeric_limits<double>::infinity();
    for (Index e = 0; e < n; ++e) {
      const double own = std::max(precision(e, e), kTiny), gained = weighted[e] * weighted[e] / own - std::log(own);
      if (left[e] && gained > gain) gain = gained, worst = e;
    }
    if (worst < 0 || !(gain > price)) break;
    out.found.push_back(int(worst)), left[worst] = false;
    out.gained += gain - price;
    const Vector column = precision.col(worst) / precision(worst, worst);
    weighted -= column * weighted[worst];
    precision -= (column * precision.row(worst)).eval();
  }
  return out;
}

}  // namespace tomotactile
