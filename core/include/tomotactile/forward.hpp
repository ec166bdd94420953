// What the readings should be: the forward model of the estimator, and its derivatives.
//
// Row l of a scan grounds electrode l through the resistance R_l. With Y = Y0 + H C H^T, C = (diag(1/g) + D)^-1 and
// Z = Y^-1
//
//     v_ln / V0 = a_n (1 - rho_ln) + o_n,     rho_ln = Z_ln / N_l,    N_l = Z_ll + S_l + R_l
//
// with S_l what its impedance is more, of another radius than that of Y0; its own reading has R_l / N_l.
// and any change dY of the admittance changes a row by
//
//     d rho_l = -(Z - z_l z_l^T / N_l) dY rho_l,    z_l = Z e_l
//
// the bracket being the impedance with electrode l grounded. An electrode that lies aside by d takes other currents
// (Hadamard's formula for moved boundaries, to first order): dY_mk = -(Y_nm B_nk + Y_nk B_nm) . d with B_nm the field
// at n while electrode m is at 1 V. Rows of contacts that move share one evaluation with those near in time; what they
// differ from it by is first order in the way between.
#pragma once

#include <functional>

#include "tomotactile/touches.hpp"

namespace tomotactile {

// A point in the space of all that is estimated.
struct Unknowns {
  Parameters contacts;
  std::vector<int> across;  // patches to the width of each
  Mask free;                // which parameters are estimated
  Rates rates;              // how fast x, y (m/s) and ln c (1/s) change
  std::vector<bool> moving; // for which contacts these are estimated
  Matrix bond;              // m x m inverse covariance of conductances of the last m contacts, cells of shapes, 1/S^2
  Vector sheet;             // J coefficients
  Vector gain, offset;      // n; offset in parts of V0
  Vector resistance;        // n, ohm
  Eigen::MatrixX2d aside;   // n x 2: how far electrodes lie aside of where the layout has them, m

  bool is_moving() const;
  bool is_finite() const;
  Index rated() const;  // number of contacts that move
  Index alone() const { return contacts.cols() - bond.rows(); }  // number of contacts that are no cells
  Vector of_cells() const { return contacts.row(kStrength).tail(bond.rows()).array().exp().matrix().transpose(); }  // c, S
  void check(const Sheet& sheet) const;  // throws BadInput
};

// Readings and all else with contacts where they are at one time.
class Snapshot {
 public:
  Snapshot(std::shared_ptr<const Sheet> sheet, const Unknowns& unknowns, const std::vector<int>& rows,
           std::shared_ptr<const Touches> touches);

  Matrix columns(const Mask& free) const;   // nL x F derivatives of the readings by contacts' parameters, without gains
  Matrix sheet_columns(const Vector& sheet) const;  // nL x J, by the coefficients of the sheet
  Matrix way_columns() const;               // nL x k, by the logarithm of D of each contact, c held
  Matrix pressure_columns(const std::vector<Matrix>& modes) const;  // by relative pressures (p x Q) of each contact
  // By how far aside the electrode that is read lies (nL x 2), and the one that is grounded.
  void aside(Matrix& read, Matrix& ground) const;
  Matrix added() const;                     // n x n: what contacts add to Y, S
  std::array<Matrix, 2> fields() const;     // n x n: at the first electrode while the second is at 1 V, 1/m

  std::shared_ptr<const Sheet> sheet;
  std::shared_ptr<const Touches> touches;
  std::vector<int> rows;
  std::vector<Conductance> conductance;  // of each contact
  Matrix ratio;       // n x L: rho
  Vector own;         // L: N, ohm
  Vector within;      // L: S / N
  Matrix impedance;   // n x n: Z, ohm
  Matrix shifted;     // n x L: 1 - rho with electrodes aside

 private:
  Matrix fed_, inner_;  // n x P: H C, and H (1 + G D)^-1
  Vector direct_;       // n: conductance of contacts on electrodes, S

  Matrix by_way(Index i) const;
  void respond(const Matrix& change, Eigen::Ref<Vector> out) const;  // of a change of Y
  void feed(const Vector& direct, Eigen::Map<Matrix>& moved) const;  // Z dY rho of one on electrodes alone, added
};

class Prediction {
 public:
  // Rows ground electrodes `rows` at `times`, s (none: all at once); `touches` where they are known, at rest.
  Prediction(std::shared_ptr<const Sheet> sheet, Unknowns unknowns, std::vector<int> rows, const Vector& times,
             std::shared_ptr<const Touches> touches = nullptr);

  // nL x F: by the contacts' free parameters in their order, then by the rates of those that move.
  Matrix contact_columns(const Unknowns& unknowns) const;
  Matrix sheet_columns() const;
  Matrix way_columns() const;
  Matrix pressure_columns(const std::vector<Matrix>& modes) const;
  void aside(Matrix& read, Matrix& ground) const;

  const Snapshot& middle() const { return *parts_[middle_].at; }
  Index work() const;  // patches in all evaluations, what the cost goes with
  Index count() const { return readings.rows(); }

  // nL x F: by the contacts' parameters that `wanted` names.
  Matrix columns(const Mask& wanted) const;

  Unknowns unknowns;
  Matrix readings;  // n x L, parts of V0
  Matrix ratio;     // n x L
  Vector own;       // L, ohm
  std::vector<int> rows;

 private:
  struct Part {
    std::vector<int> which;  // of the rows
    std::shared_ptr<const Snapshot> at;
  };
  std::vector<Part> parts_;
  std::size_t middle_ = 0;
  Vector times_;
  Mask wanted_;      // of `columns_`, where something moves
  Matrix columns_;

  Matrix gather(const std::function<Matrix(const Snapshot&)>& columns, bool gained) const;
};

}  // namespace tomotactile
