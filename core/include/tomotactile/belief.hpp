// What is known of the contacts between one row and the next: a Gaussian of their numbers and the sensor's.
//
// A contact goes on with an acceleration of which only the size is known, white in time; what of it a row does not see
// is q ((t^3/3, t^2/2), (t^2/2, t)) (Bar-Shalom, Li and Kirubarajan 2001, 6.2.2). ln c walks at random. What rows have
// told of the sensor is forgotten in a minute.
#pragma once

#include "tomotactile/rows.hpp"

namespace tomotactile {

// m/s that the velocity changes by in so many s, standard deviation: a hand's mean acceleration; jerks are noticed and
// told apart
constexpr double kEnduring = 0.3, kWithin = 1.0;
constexpr double kSlow = 0.02;  // m/s: what is slower rests

struct Belief {
  Vector mean;                     // 5 k + S: contacts first, then the sensor's shift from what is known
  Matrix covariance;
  Eigen::Matrix2Xd sizes;          // ln a and its variance
  std::vector<int> numbers, rows;  // that stay; rows read since they began
  std::vector<double> begun;       // s

  static Belief untouched(const Vector& deviation);  // no contact; standard deviations (S) of the sensor

  Index count() const { return sizes.cols(); }
  Discs contacts(const Vector& of) const;  // of that mean
  Discs contacts() const { return contacts(mean); }

  // `lasts` s later. The sensor slowly becomes as unknown as before, `deviation` (S): what the model lacks makes rows less
  // independent than they are taken for. That may be made up for later: `faded` s of it are due now.
  Belief later(double lasts, const Vector& deviation, double faded) const;
  Belief loosened(const Eigen::Matrix<double, kState, 1>& variances) const;  // added to those of each contact
  Belief of_sensor() const;                                                  // without any contact, whatever those were
  Belief without(Index which) const;
  Belief with_contact(const Eigen::Matrix<double, kState, 1>& mean, const Eigen::Matrix<double, kState, kState>& covariance,
                      const Eigen::Vector2d& size, int number, double begun, int rows = 0) const;
  Belief unlearned(const Vector& deviation) const;  // the contacts alone, of a sensor of which no row has told anything
  void check() const;                               // throws BadInput where sizes differ
};

}  // namespace tomotactile
