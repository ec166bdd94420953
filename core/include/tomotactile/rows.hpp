// One row as small contacts make it, its derivatives, and what it tells: the iterated extended Kalman filter of the cost
// that frames minimise (Bell and Cathey 1993), a row at a time.
//
// The forward model is that of forward.hpp with one patch to a contact. With Zb the impedance of sheet and wide contacts,
// H the shares of the small ones, C^-1 = diag(1/c) + D (0 on the diagonal, as c includes it), and electrode l grounded
// through R_l
//
//     z = Zb e_l - Q A^-1 Q_l,     Q = Zb H,    A = C^-1 + H^T Q         (Woodbury)
//     rho = z / N,   N = z_l + R_l,   v = a (1 - rho) + o,   dv = a M dY rho,   M = Zb - Q A^-1 Q^T - z z^T / N
//
// Without wide contacts the sheet floats, Y0 1 = 0, and Zb is infinite along 1. Any generalised inverse then serves as
// Zb if M and z are given what a potential of all electrodes adds, p p^T / s with w = A^-1 1, s = 1^T w, p = 1 - Q w.
// The share of a disc in an electrode is that of its centre but for the logarithm of their distance, which is averaged
// over the disc where it reaches the electrode; of one that covers an electrode in part it is the mean over its area: 1
// in the electrode for what lies on it, and that of patches beside it for the rest (as in touches.hpp). (Current prefers
// the electrode, the more the better a disc conducts; to count that makes shares depend on ln c, and hard presses were
// lost.) Where electrodes lie is known to a part of a spacing: that is noise of single readings, and for the grounded
// electrode of all.
#pragma once

#include <map>

#include "tomotactile/sheet.hpp"

namespace tomotactile {

constexpr int kState = 5;  // numbers of a contact that rows estimate: x, y (m), vx, vy (m/s), ln c
using Discs = Eigen::Matrix<double, 4, Eigen::Dynamic>;  // one contact a column: x, y, ln c, ln a
using Read = std::vector<bool>;                          // which readings of a row are valid

// What is known of the sensor, about which rows are linear in the rest.
struct Sensor {
  Vector sheet;                    // J coefficients
  Vector gain, offset, resistance; // n; offset in parts of V0, ohm
  Vector resistance_deviation;     // n, ohm
  Eigen::MatrixX2d aside, unsure;  // n x 2: how far electrodes lie aside, mean and standard deviation, m
  Vector alone;                    // n: variance of single readings, parts of V0 squared
  Vector deviation;                // J + n: standard deviations of coefficients and gains before rows told of them
};

struct Row {
  Vector readings, driven, variance, ratio;  // n: v / V0; 1 - rho; of what is not known of single readings; rho
  Matrix changes;                            // n x (5 k + J) derivatives by contacts and sheet; 0 where not valid
  Matrix common;                             // n x 3 standard deviations that all readings share
  double own = 0;                            // N, ohm
  Matrix spread, matrix;                     // Q, n x k; A, k x k
  Vector lifted;                             // n: p / s^(1/2)
};

// How likely a row was, and what is believed after it.
struct RowFit {
  Vector mean;
  double chi_squared = 0;
  Row row;
  Vector misfit;          // n: what is left of the readings
  Matrix root;            // n x n lower Cholesky factor of its covariance S
  Matrix spread, shares;  // n x S covariance of readings with the state; root^-1 of its first columns

  double cost() const;    // -2 ln(likelihood), but for a constant
  void correct(Eigen::Ref<Matrix> covariance) const;  // that before the row becomes that after it
};

class RowModel {
 public:
  // `wide` contacts are part of `impedance` (Zb) and `fields`, n x n each.
  RowModel(std::shared_ptr<const Sheet> sheet, Sensor sensor, Matrix impedance, std::array<Matrix, 2> fields, Discs wide);

  Index count() const { return sheet_->count(); }
  Index modes() const { return sheet_->modes(); }
  const Matrix& impedance() const { return impedance_; }
  const Vector& gain() const { return sensor_.gain; }
  const Vector& deviation() const { return sensor_.deviation; }
  // ln c of a contact that raises the reading of an electrode near it by one standard deviation of noise.
  double faintest() const { return std::log(std::sqrt(sensor_.alone.mean()) * 2 * kPi / sheet_->tables().resistance); }
  const Discs& wide() const { return wide_; }
  void shares(const Discs& contacts, Matrix& share, std::array<Matrix, 2>& slopes) const;  // H, n x k; slopes, 1/m
  Matrix shares_added(const Points& places) const;  // n x K: what the sheet as it is known adds to H of an even one
  // D between contacts, k x k, ohm; 0 for each with itself and where electrodes screen them; none where they do everywhere.
  Matrix mutual(const Discs& contacts) const;
  // `shift` (J + n) of the sheet's coefficients and of gains from those known; `mutual` D, k x k, or none.
  Row row(const Discs& contacts, Index ground, const Vector& shift, const Matrix& mutual, const Read& valid) const;
  Row idle() const;  // of an untouched sheet

  // The belief `mean` with its covariance, of discs of radii exp(`sizes`), after a row: linearised `steps` times at the
  // most, about `start` first if there is one; of the contacts alone unless the row is to tell of the sensor.
  RowFit fit(const Vector& mean, const Eigen::Ref<const Matrix>& covariance, const Vector& sizes, const Matrix& mutual,
             const Vector& readings, const Read& valid, Index ground, int steps, const Vector* start, bool learns) const;
  RowFit idle_fit(const Vector& mean, const Vector& readings, const Read& valid) const;
  // The way from `now` to `wanted`, cut to what one linearisation holds for, on the sheet.
  Vector limited(const Vector& now, const Vector& wanted, Index contacts) const;

 private:
  struct Kept {  // derivatives of the last row of an electrode
    Discs contacts;
    Read valid;
    Matrix changes;
    Vector moved, variance;
    Eigen::MatrixX2d deviation;
  };
  std::shared_ptr<const Sheet> sheet_;
  Sensor sensor_;
  Matrix impedance_;
  std::array<Matrix, 2> fields_;
  Discs wide_;
  Eigen::MatrixXf change_;  // n x (n J): derivatives of Y0; memory is what they cost, once a row
  Matrix added_;            // n x M: what the sheet adds to H at the points of the coarse lattice, or none
  Vector within_;           // n, ohm: what impedances of electrodes are more, of another radius
  Eigen::Vector2d inside_;
  double least_, most_;     // ln c
  mutable std::vector<Kept> kept_;
  mutable std::pair<Discs, Matrix> mutual_;
  mutable std::map<std::pair<int, int>, Eigen::MatrixXf> by_sheet_;

  // Whether contacts are nearly the same: what changes slowly with them is kept.
  bool alike(const Discs& one, const Discs& other, double place, double size) const;
  bool at_rim(const Eigen::Vector2d& place, double radius, Eigen::Matrix<double, Eigen::Dynamic, 3>& found) const;
  const Eigen::MatrixXf& by_sheet(const Eigen::Vector2d& place) const;  // n x J
  Kept derivatives(const Discs& contacts, Index ground, const Row& row, const Matrix& share, std::array<Matrix, 2> slopes,
                   const Matrix& between, const Read& valid) const;
};

}  // namespace tomotactile
