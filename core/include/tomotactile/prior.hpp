// What was read, and what is expected of contacts, sheet and channels before the readings: means and covariance.
#pragma once

#include <Eigen/SparseCore>

#include "tomotactile/forward.hpp"

namespace tomotactile {

constexpr Index kKinds = 5;  // of a channel: gain, offset, resistance to ground, how far aside in x and y

struct Rows {
  Matrix readings, weights;  // n x L: parts of V0; one over the variance of the noise, 0 where nothing was read
  std::vector<int> grounded; // among the electrodes in use
  Vector times;              // s against the time for which contacts are estimated; empty: all at once
  Index count = 0;           // of readings

  Rows(Matrix readings, Matrix weights, std::vector<int> grounded, Vector times);
  bool same(const Rows& other) const;  // electrodes and weights
};

struct Prior {
  double radius, spread, stretch;  // median of radii, m; deviation of their logarithms; of p and q
  Eigen::Vector3d rates;           // deviations of m/s, m/s, 1/s
  Vector mean;                     // J + 5 n: sheet, gains, offsets, resistances, ways aside in x, in y
  Vector deviation;                // J + 5 n
  Eigen::SparseMatrix<double> precision;  // (J + 5 n)^2 inverse covariance
  bool joint;                      // whether that is more than the deviations
  bool apart_in_channels = true;   // whether gains and offsets of different channels are independent
  Index modes;

  Prior(double radius, double spread, double stretch, const Eigen::Vector3d& rates, Vector mean, Vector deviation,
        const Matrix& precision, Index modes);  // precision 0 x 0: all are independent
  Vector apart(const Unknowns& unknowns) const;
  Vector pull(const Vector& apart) const { return precision * apart; }
  Matrix of_sheet() const { return Matrix(precision).topLeftCorner(modes, modes); }
  bool same_sensor(const Prior& other) const;  // whether both weigh the sensor alike
};

}  // namespace tomotactile
