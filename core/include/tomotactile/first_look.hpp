// The first look at a frame, which has no fit to start from: contacts from the currents of electrodes.
//
// By Kirchhoff's law a floating electrode draws no current: with rho as measured, (Y0 rho_l)_n is what contacts feed
// into it, - sum_k c_k H_nk (h_k . rho_l), linear in all c at once and local, as electrodes held at potentials screen
// contacts from each other. What a contact of 1 S feeds is a product of a row's and an electrode's factor, and so are
// its derivatives: products of such columns with each other are products of their factors.
//
// Pixels are picked in turn, the one that explains most of what is left first; after each pick all conductances are
// solved for, none negative (orthogonal matching pursuit; Pati et al. 1993). Small contacts lie between pixels, and the
// best pixel for two of them lies between them: as points they slide by Gauss-Newton steps, after each pick, to where
// they explain most (sliding Frank-Wolfe, Denoyelle et al. 2019), which is within a millimetre of where they are. Where
// no pick explains more, one is tried for what it explains that no change of the others does (orthogonal least
// squares; Chen et al. 1989).
#pragma once

#include "tomotactile/fit.hpp"

namespace tomotactile {

constexpr int kFew = 6;  // points that may be parts of something wide; more are a spacing from each other

// Points with conductances, S, and what they leave of the square of the currents.
struct Seen {
  Points places;
  Vector strengths;
  double left = 0;
};

class FirstLook {
 public:
  // Rows without what is known of gains and offsets, and standard deviations of what is not, n each; Y0 as it is
  // expected; pixels about `side` apart, m, with H there, n x K.
  FirstLook(std::shared_ptr<const Sheet> sheet, const Matrix& admittance, const Rows& rows, const Vector& gain,
            const Vector& offset, Points pixels, const Matrix& share, double side);

  // Points of a radius, m, each a contact, beside which no further one explains anything.
  Seen points(double radius) const;
  // Pixels that explain most together, whatever form contacts have.
  Seen contacts() const;
  // Conductances, S, none below 0, of contacts of `share` (n x K) that explain most together: a linear image.
  Vector image(const Matrix& share) const;
  double total() const { return total_; }

 private:
  // What contacts of 1 S feed into electrodes: `driven` (L x m) times `share` (n x m), but into the grounded one, whose
  // share is `local` (L x m); the metric times `share`, `weighted`, and that of the grounded one, `pulled`.
  struct Columns {
    Matrix driven, share, local, weighted, pulled;
  };
  struct Slid : Seen {
    Columns columns;         // 5 k: values, and the parts of the derivatives by x and y
    Matrix normal;           // 3 k x 3 k products of values and derivatives
    Vector along;            // 3 k: with what is left
  };

  std::shared_ptr<const Sheet> sheet_;
  std::vector<int> grounded_;
  Points pixels_;
  double side_, total_ = 0, noise_ = 0;
  Matrix ratio_, metric_, wanted_;  // n x L rho; n x n; the metric times the currents, n x L
  Vector at_ground_, wanted_ground_;  // L: of both at the grounded electrode
  Columns all_;                     // of the pixels
  Vector along_, power_;

  Columns columns(Matrix driven, Matrix share) const;
  Matrix between(const Columns& these, const Columns& others) const;
  Vector along(const Columns& of) const;
  Vector squares(const Columns& of) const;
  Slid slid(Points places, double radius, int steps) const;
  Vector gains(const Slid& points, bool beside) const;
  double beside(const Slid& points, Index pixel) const;
  bool are_contacts(const Slid& points) const;
};

}  // namespace tomotactile
