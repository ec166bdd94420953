// Readings of a row that its contacts contradict: a channel may be wrong instead of something new on the sheet.
//
// A wire that is exchanged or broken, a channel that is stuck, interference on one wire: such a reading may be anything
// from 0 V to the drive voltage, equally likely. For each reading, that is compared with the Gaussian in which it was
// expected, all other readings given. With the precision A = S^-1 of the misfit e, leaving out reading k takes
//
//     (A e)_k^2 / A_kk - ln(A_kk)
//
// from e^T A e + ln det S, exactly as long as nothing is linearised anew, and leaves the Schur complement of A_kk for the
// next one. What it costs is what `kWrong` says. That is the mixture of a sharp and a flat density by which outliers are
// usually modelled (Box and Tiao 1968), with the most likely component instead of the sum of all.
#pragma once

#include "tomotactile/rows.hpp"

namespace tomotactile {

constexpr double kWrong = 1e-3;  // probability that a given row has a given reading wrong: one of 64 once in 16 rows

struct Outliers {
  std::vector<int> found;  // which readings are rather wrong than what was expected
  double gained = 0;       // by how much that lowers -2 ln(likelihood)
};

// `most` of the `valid` readings of a row; misfit (n), root (n x n) the lower Cholesky factor of its covariance.
Outliers outliers(const Vector& misfit, const Matrix& root, const Read& valid, int most);

}  // namespace tomotactile
