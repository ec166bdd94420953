// Where a new contact would explain what a row has beyond what was expected: a matched filter over a coarse lattice.
//
// A current alpha that a new contact at x feeds in changes the row by alpha s(x), s = M h(x) (rows.hpp), whatever else
// touches, exactly; alpha = c (h . rho) / (1 + c h . s) > 0 bounds it. With the covariance S of what was not expected
//
//     gain(x) = (s^T S^-1 e)^2 / (s^T S^-1 s)
//
// is the square of a standard normal number where there is nothing new, and counts for alpha > 0 only. The threshold is
// exceeded somewhere once in so many hours of rows as `estimation.follow` says: the probability for a row is divided by
// the number of places and of sums over rows that are looked at (Bonferroni), one-sided.
#pragma once

#include "tomotactile/rows.hpp"

namespace tomotactile {

class Births {
 public:
  // At places (2 x K), m, of contacts of a radius, m; `threshold` of gains.
  Births(std::shared_ptr<const Sheet> sheet, Points places, double radius, double threshold);

  struct Gains {
    Vector gains, conductances;  // K; S
    bool any;                    // whether one exceeds the threshold
  };
  // Of a row as `fit` has it without anything new; of this row or with those before: `sums` (K x 2) of these go on.
  Gains look(const std::shared_ptr<const RowModel>& model, const RowFit& fit, Index ground, Matrix& sums) const;
  Matrix nothing() const { return Matrix::Zero(places_.cols(), 2); }  // sums before any row
  // Some x, y, ln c to begin a fit with, that of the largest gain first.
  std::vector<Eigen::Vector3d> starts(const Gains& gains) const;

 private:
  std::shared_ptr<const Sheet> sheet_;
  Points places_;
  Matrix even_;       // n x K: H on the even sheet
  double threshold_;
  double limit_;      // S: what a contact conducts at most
  mutable std::shared_ptr<const RowModel> model_;
  mutable Matrix shares_, spread_;  // of the model: H, Zb H
};

}  // namespace tomotactile
