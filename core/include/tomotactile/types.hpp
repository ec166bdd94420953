// Names for what everything here is made of. Arrays keep the memory of numpy: what Python calls (P, n) in C order is
// an n x P matrix here, so that nothing is copied in another order.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace tomotactile {

using Index = Eigen::Index;
using Vector = Eigen::VectorXd;
using Matrix = Eigen::MatrixXd;
using Points = Eigen::Matrix2Xd;                          // one place a column, m
using Parameters = Eigen::Matrix<double, 6, Eigen::Dynamic>;  // one contact a column, see contact.hpp
using Rates = Eigen::Matrix<double, 3, Eigen::Dynamic>;
using Mask = Eigen::Array<bool, 6, Eigen::Dynamic>;

constexpr double kPi = 3.14159265358979323846;

// What a caller handed over that cannot be: shown to the user in one line.
struct BadInput : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

}  // namespace tomotactile
