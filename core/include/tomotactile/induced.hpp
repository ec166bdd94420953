// What floating electrodes add to G between two places: the charge that a current induces on a conducting disc lies in
// its inverse point (circle theorem; Milne-Thomson 1940).
//
// From the centre of an electrode of radius R, with the way a to a place as a complex number and z = R / conj(a),
//
//     R_s / (2 pi) ln |1 - z_p conj(z_q)| = - R_s / (2 pi) (Re z_p conj(z_q) + Re z_p^2 conj(z_q)^2 / 2 + ...)
//
// The first term, of a dipole, is felt over the whole sheet, beside the electrode even from places far away, and from
// their images in the rims of a rectangle: with S the sum of z over a place and its images it is
//
//     - R_s / (2 pi) s Re S_p conj(S_q)
//
// s is the part of the electrode that lies on the sheet: one with its centre on a rim is its own image. The rest of the
// logarithm is taken where both places are near enough to tell.
#pragma once

#include "tomotactile/types.hpp"

namespace tomotactile {

constexpr double kRim = 1.001;  // radii from an electrode's centre: patches on it are moved here and have no weight

struct InducedCharges {
  Points centres;        // of all electrodes, m
  double radius = 0;     // m
  double scale = 0;      // R_s / (4 pi), ohm
  Eigen::Vector2d size;  // of a rectangle that mirrors, m; else 0
  // signs of the images of each electrode that lie in its own place, itself included: one on a rim is its own image
  std::vector<std::vector<Eigen::Vector2d>> own_images;
  Vector counted;        // E: how many these are, 1 / s
  Vector weights;        // 2 E, ohm: R_s s / (2 pi) of the rows of `dipoles`

  InducedCharges() = default;
  InducedCharges(Points centres, double radius, double resistance, const Eigen::Vector2d& size);

  Matrix dipoles(const Points& places) const;                       // S: real parts, then imaginary ones, 2 E x P
  std::array<Matrix, 2> dipole_slopes(const Points& places) const;  // its change with the place, 1/m
  // 2 E x n, ohm: its product with `dipoles` is what they make of G between a place and the middle of electrodes.
  Matrix fed(const Points& electrodes) const;
  Vector own(const Points& places) const;  // P: what a current at each place brings about there, ohm
};

// Those that currents at places induce.
class Charges {
 public:
  Charges() = default;
  Charges(const InducedCharges& electrodes, const Points& places);

  // Adds what they make of G between places `first` ... `first + p` and `others`, p x q, ohm.
  void add_between(Index first, Index count, const std::vector<int>& others, Matrix& out) const;
  // Adds the change of that with the place of the first, ohm/m; `steep`: the `dipole_slopes` of these.
  void add_slope(Index first, Index count, const std::vector<int>& others, const std::array<Matrix, 2>& steep, Matrix& along_x,
                 Matrix& along_y) const;
  const Matrix& dipoles() const { return dipoles_; }

 private:
  struct Close {  // an electrode beside some of the places
    std::vector<int> number;       // of each place among those near enough, or -1
    Points z;                      // of these
    std::vector<Points> seen;      // the same of their images in the rims that it lies on, themselves included
  };

  struct Pairs {
    std::vector<int> here, on, theirs;  // which of the first and of the others; the latter's numbers
    Points z;                           // of the first
  };
  static Pairs beside(const Close& close, Index first, Index count, const std::vector<int>& others);

  const InducedCharges* electrodes_ = nullptr;
  std::vector<Close> close_;
  Matrix dipoles_;  // 2 E x P
};

}  // namespace tomotactile
