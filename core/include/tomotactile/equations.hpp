// Normal equations at a fit, of contacts alone, and of contacts, sheet and channels, and the one solver.
//
// Linearised least squares with priors (Tarantola 2005, chapter 3) by Gauss-Newton with Levenberg's damping, which
// acts on contacts alone: the rest is nearly linear. Channels are eliminated first (channels.hpp); derivatives by the
// sheet are kept while contacts stay, since they change slowly and only how fast the solver converges depends on them.
#pragma once

#include "tomotactile/fit.hpp"

namespace tomotactile {

// Whether contacts are nearly the same as others, one by one: within a part of the spacing and as much in form.
bool similar(const Parameters& contacts, const Parameters& others, double pitch, double within);

// Derivatives by the sheet's coefficients, at a fit.
struct SheetColumns {
  Matrix flat, weighted;  // nL x J; times the weights
  Matrix normal;          // J x J

  explicit SheetColumns(const Fit& fit);
  bool serves(const Fit& fit) const;  // good enough at another fit

 private:
  std::shared_ptr<const Rows> rows_;
  Parameters contacts_;
  bool bonded_;
  Matrix added_;
};

// All that the normal equations have at a fit whatever the readings are.
struct Equations {
  std::shared_ptr<const Fit> fit;
  Matrix contacts;  // nL x F derivatives by the contacts' free parameters, times the weights
  std::shared_ptr<const SheetColumns> sheet;
  ChannelFit channels;
  Matrix normal;    // (F + J)^2 of contacts and sheet with the priors, channels eliminated
  Vector stiffness; // of each parameter of a contact, the part that is left of its diagonal where the sheet gives way

  Equations(std::shared_ptr<const Fit> fit, Matrix flat, const Matrix& of_contacts, std::shared_ptr<const SheetColumns> sheet);

  Matrix inverse() const;  // covariance of contacts and sheet, channels marginal
  Matrix response(const Matrix& misfits) const;  // F x m: how contacts answer to misfits, nL x m, all else marginal
  Matrix by_ways() const { return response(fit->prediction->way_columns()); }
  // What the contacts' parameters `free`, held so far, would take off the cost of a fit near, to first order and all
  // else following (score test, Rao 1948).
  double score(const Fit& fit, const Mask& free) const;
  // How much more uneven the sheet of a fit near is than was expected (evidence procedure; MacKay 1992), at least 1.
  double unevenness(const Fit& fit) const;
  bool are_of(const Fit& fit) const;  // the same parameters and rows
  bool serves(const Fit& fit) const;  // good enough at another fit, of other readings
  bool bends(const Fit& fit) const;   // whether a contact there is so much nearer to a bare conductor, or farther
};

// Derivatives of ln 1 / (1/g + mean D) by ln c: 1, but for bare conductors.
Vector answering(const Prediction& prediction);

struct Step {
  Unknowns unknowns;
  double promised;  // how much the cost should fall by the linear model
  bool whole;       // hardly damped and not limited
};

// Of known equations: all where they serve, derivatives by the sheet alone, or all of the same parameters wherever they are.
enum class Taken { kServing, kSheet, kAll };

class Linear {
 public:
  static Linear of_contacts(std::shared_ptr<const Fit> fit);  // the sensor as it is there
  // Of contacts and sheet, channels eliminated, with what is taken of equations known from a fit nearby.
  static Linear of_all(std::shared_ptr<const Fit> fit, std::shared_ptr<const Equations> known, Taken taken = Taken::kServing);

  Linear about(std::shared_ptr<const Fit> fit) const;  // the right side of a fit nearby: a chord for a tangent
  Step step(double damping) const;
  double excess(const Vector& step) const;     // times as far as the linearisation holds, at least 1
  Unknowns after(const Vector& step) const;    // contacts within bounds after a step, and the sensor with them
  double promise() const;     // what an undamped step takes off the cost, to first order
  Matrix covariance() const;  // of the contacts' free parameters
  Unknowns followed(Unknowns unknowns, const Vector& step) const;  // with the sensor after a step of contacts and sheet

  std::shared_ptr<const Fit> fit;
  std::shared_ptr<const Equations> equations;  // null: of contacts alone
  Index free = 0;
  Vector units;     // F: what cells conduct in parts of what they do where the equations are of; empty: they are of here
  Matrix flat;      // nL x F, of contacts alone
  Matrix normal;
  Vector right, stiffness;
  double beside = 0;  // what all that is not a parameter here takes off the cost
  Vector alone;       // steps of the channels if nothing else moves

 private:
  void aim(const Vector& pull);
};

constexpr double kFirstDamping = 1e-3;
constexpr double kReach = 0.3, kReachStrength = 1.5;  // spacings and of ln c: one linearisation holds for it
constexpr double kSimilar = 0.04;  // spacings that contacts move before derivatives by the sheet are taken anew
constexpr int kSteps = 12;  // at most, from one start

struct Solution {
  std::shared_ptr<const Fit> fit;
  std::shared_ptr<const Equations> equations;
  Matrix covariance;  // of the contacts' free parameters, all else marginal
  int steps = 0;
  double work = 0;    // patches in all evaluations
};

// Nearer to the best fit, by steps of the contacts alone; what the sensor leaves over is doubted.
Solution approach(std::shared_ptr<const Fit> fit, double most);
// The best fit that at most `steps` lead to; ends where nothing tells that `goal` will be reached, and after `most` work.
Solution solve(std::shared_ptr<const Fit> fit, int steps, std::shared_ptr<const Equations> known, double goal, double most);

}  // namespace tomotactile
