// What floating electrodes close by add to G between two places: the charge that a current induces on a conducting
// disc lies in its inverse point (circle theorem; Milne-Thomson 1940).
//
// With a the way from the centre of an electrode of radius R to a place, as a complex number, and z = R / conj(a),
// that is
//
//     R_s / (2 pi) ln |1 - z_p conj(z_q)| = - R_s / (2 pi) sum_k Re(z_p^k conj(z_q)^k) / k
//
// Some radii away the sum has few terms, and for all places and electrodes together it is one product of matrices;
// close to an electrode the logarithm is taken as it is. Electrodes fade in and out between 0.8 and 1.3 spacings.
#pragma once

#include "tomotactile/types.hpp"

namespace tomotactile {

constexpr double kRim = 1.001;  // radii from an electrode's centre: patches on it are moved here and have no weight

struct InducedCharges {
  Points centres;  // of all electrodes, m
  double radius = 0, pitch = 0;
  double scale = 0;  // R_s / (4 pi), ohm

  // 1 near an electrode, 0 far away, at squared distances, m^2; and its change with these, 1/m^2.
  double nearness(double squared) const;
  double nearness_slope(double squared) const;
  double squared(double x, double y) const;  // of a way from a centre, that of the rim at least
};

// Those that currents at places induce on the electrodes near any of them.
class Charges {
 public:
  Charges() = default;
  Charges(const InducedCharges& electrodes, const Points& places);

  // Adds what they make of G between places `first` ... `first + p` and `others`, p x q, ohm.
  void add_between(Index first, Index count, const std::vector<int>& others, Matrix& out) const;
  // Adds the change of that with the place of the first, ohm/m.
  void add_slope(Index first, Index count, const std::vector<int>& others, Matrix& along_x, Matrix& along_y) const;

 private:
  struct Close {  // an electrode so near that its sum would be long
    Eigen::ArrayXd weight, share, fading;
    Points apart, image;
  };
  static std::vector<int> there(const Close& close, const std::vector<int>& chosen);

  struct Far {  // the rows below of an electrode, and the places that are near it
    Index first, count;
    std::vector<bool> near;

    bool reaches(Index place, Index places) const;
  };

  const InducedCharges* electrodes_ = nullptr;
  std::vector<Close> close_;
  std::vector<Far> far_;
  Matrix columns_;             // 2 K m x P: B with B^T B what charges take away
  Matrix along_x_, along_y_;   // its change with the place
};

}  // namespace tomotactile
