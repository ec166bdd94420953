// A point of the search: unknowns, what they predict, and what is left of the readings.
#pragma once

#include "tomotactile/channels.hpp"
#include "tomotactile/prior.hpp"

namespace tomotactile {

struct Fit {
  std::shared_ptr<const Sheet> sheet;
  Unknowns unknowns;
  std::shared_ptr<const Rows> rows;
  std::shared_ptr<const Prior> prior;
  std::shared_ptr<const Prediction> prediction;
  Matrix misfit;           // n x L: reading minus prediction
  double chi_squared = 0;  // of the readings
  double cost = 0;         // with the priors

  Fit(std::shared_ptr<const Sheet> sheet, Unknowns unknowns, std::shared_ptr<const Rows> rows,
      std::shared_ptr<const Prior> prior, std::shared_ptr<const Prediction> prediction = nullptr);

  Fit with(Unknowns unknowns) const;
  Fit weighed(std::shared_ptr<const Rows> rows) const;  // rows that differ in their weights only

  // What a significant change of the cost is to be multiplied with: 1 where noise explains the misfit. What the model
  // lacks makes all readings of an electrode err together; its excess counts once for each.
  double doubt() const;
  double of_sensor() const;  // what the prior of the sensor takes of the cost
  Slopes slopes() const;     // derivatives of the readings by the channels
};

// What the priors of the contacts' free parameters and rates add to the normal matrix and to its right side.
void contact_priors(const Fit& fit, Matrix& curvature, Vector& pull);

}  // namespace tomotactile
