// The sheet as the electrodes see it: Y0, and tables from which H and D of contacts anywhere are read.
//
// All electrodes held at potentials u against the driving layer draw the currents Y u. Without contacts Y is Y0;
// contacts add H (diag(1/g) + D)^-1 H^T. Y0 is the Dirichlet-to-Neumann map of the sheet at its electrodes, H holds
// the potentials of the sheet with one electrode at 1 V and all others at 0 V, D the Green function with all
// electrodes at 0 V. With G the Neumann Green function and B the inverse of [G 1; 1^T 0] for the electrodes,
//
//     H(x) = B [G(., x); 1],     D(x, y) = G(x, y) - [G(., x); 1]^T B [G(., y); 1]
//
// A sheet whose conductance is sigma exp(m(x)) changes them to first order in m (Polydorides and Lionheart 2002):
//
//     dY0_nk = int sigma m grad H_n . grad H_k,     dH_n(x) = - int sigma m grad D_x . grad H_n
//
// and D near x by the factor exp(-m(x)). For pairs of electrodes that see each other the first is taken as a change
// of the logarithm. Tables come from whoever knows the layout (finite elements, closed forms); nothing here solves a
// field problem.
#pragma once

#include <complex>

#include "tomotactile/induced.hpp"
#include "tomotactile/lattice.hpp"
#include "tomotactile/outline.hpp"
#include "tomotactile/types.hpp"

namespace tomotactile {

// A disc of radius 1 or a square of its area cut into patches that a contact stretches.
struct Cut {
  Points points;
  Vector area, radii;  // shares of the area; radii of the patches
};

// A mirror in a rim: z -> straight z + turned conj(z) + shift, seen by one electrode.
struct Mirror {
  int electrode;
  std::complex<double> straight, turned, shift;
};

struct Tables {
  Outline outline;
  Points centres;             // of all electrodes, m
  std::vector<int> position;  // of each electrode among the n in use, or n
  double radius = 0, resistance = 0, pitch = 0;
  Points used;                // centres of those in use
  Matrix inverse;             // B, (n + 1) x (n + 1)
  Matrix admittance;          // Y0 of the even sheet, S
  std::vector<Cut> discs;     // by patches to the width

  Lattice fine;               // of potentials
  Matrix potentials;          // n x K: G without its logarithm and dipoles, ohm
  Vector own;                 // K: what is only known of patches with themselves, ohm
  Lattice coarse;             // of what is smooth
  Matrix smooth;              // M x M: G without logarithms and induced charges, ohm
  InducedCharges induced;     // of all electrodes
  Vector counted;             // n: how often the logarithm of each electrode counts, with its images at its place
  Matrix fed;                 // 2 E x n: what dipoles of all make of the potentials of those in use, ohm; made from the above

  std::array<Matrix, 2> fields;   // n x n each: at the first electrode while the second is at 1 V, 1/m
  std::vector<Mirror> mirrors;
  std::array<Matrix, 2> between;  // n x n each: `kernel` at the electrodes; made from the above

  Matrix change;                     // n x J n: of ln Y0 where electrodes see each other, else of Y0, S
  Eigen::Array<bool, Eigen::Dynamic, Eigen::Dynamic> seen;
  Matrix share_change;               // J n x M: of H at the points of `coarse`
  Vector inside;                     // n: ohm that electrodes' own impedances change by, per unit of the last mode:
  double printed = 0;                // the logarithm of what all radii have in common; where it is as solved
  Points cells;                      // centres of the cells of the field, m
  double reach = 0;                  // over which cells are averaged, m
  Matrix nodes;                      // C x F, of the first F of J

  void complete();                   // checks shapes, throws BadInput; makes what follows from the rest
};

// What first order leaves of a sheet far from even (`estimation.uneven`), about the coefficients `mean`.
struct Rest {
  Matrix factor, term;  // n x n: of ln Y0, and of Y0 where that has none
  Matrix share;         // n x M of H
  Vector own;           // M of D, ohm of an even sheet
};

class Sheet {
 public:
  Sheet(std::shared_ptr<const Tables> tables, Matrix untouched);
  Sheet(std::shared_ptr<const Tables> tables, Matrix untouched, Vector mean, Rest rest);

  const Tables& tables() const { return *tables_; }
  Index count() const { return tables_->admittance.rows(); }
  Index modes() const { return tables_->change.cols() / count(); }
  const Matrix& untouched() const { return untouched_; }
  bool even(const Vector& sheet) const { return !rest_ && sheet.isZero(0.0); }
  bool about_even() const { return !rest_; }

  Matrix admittance_of(const Vector& sheet) const;                     // n x n, S
  Matrix admittance_change(const Vector& sheet) const;                 // n x J n, S
  Matrix share_added(const Vector& sheet, const std::vector<int>& nodes) const;  // n x m
  Vector own_added(const Around& around) const;                        // P, ohm of an even sheet
  Matrix field_at(const Points& places) const;                         // Q x J
  Vector inside(const Vector& sheet) const { return tables_->inside * (sheet[modes() - 1] - tables_->printed); }  // n, ohm

  // G between electrodes in use and places, n x P, ohm; its slopes, ohm/m. Those of `induced` there are given.
  Matrix potentials_at(const Points& places, const Matrix& dipoles) const;
  std::array<Matrix, 2> steep_at(const Points& places, const std::array<Matrix, 2>& dipole_slopes) const;
  // Sums over places of these, n x m: weights (m x P) of G, of its slope along x and along y.
  Matrix potentials_sum(const Points& places, const std::array<Matrix, 3>& weights) const;
  // H of discs of a radius, m, at places, n x P, on an even sheet and on that it is right about; its slopes, 1/m.
  void even_discs_at(const Points& places, double radius, Matrix& share, std::array<Matrix, 2>& slopes) const;
  void discs_at(const Points& places, double radius, Matrix& share, std::array<Matrix, 2>& slopes) const;
  Vector alone_at(const Points& places) const;        // what is only known of places with themselves, ohm
  std::array<Vector, 2> alone_steep_at(const Points& places) const;

  // Field x, y at the electrodes of 1 A fed in at places, n x P each, V/m, without what changes slowly.
  std::array<Matrix, 2> kernel(const Points& places) const { return kernel_of(*tables_, places); }
  static std::array<Matrix, 2> kernel_of(const Tables& tables, const Points& places);

 private:
  std::shared_ptr<const Tables> tables_;
  Matrix untouched_;
  Vector mean_;
  std::shared_ptr<const Rest> rest_;

  void add_read(const Points& places, Matrix* potentials, std::array<Matrix, 2>* slopes) const;  // without dipoles
  Matrix changed(const Vector& sheet) const;
  Matrix scaled(const Matrix& changed) const;
};

}  // namespace tomotactile
