// Solutions of small symmetric systems; compiled once, as templates of factorisations take long to compile.
#pragma once

#include <memory>

#include "tomotactile/types.hpp"

namespace tomotactile {

// Solution of a symmetric system that is positive definite unless tables are off: Cholesky, else LU.
Matrix solved(const Matrix& system, const Matrix& right);
Matrix inverse_of(const Matrix& system);
// Solution with the least norm of a symmetric system that rounding leaves without full rank; 0 where it is not finite.
Vector least_squares(const Matrix& system, const Vector& right);

// x >= 0 with the least x^T normal x / 2 - along^T x: active sets (Lawson and Hanson 1974, chapter 23). Throws
// std::domain_error where no end is found.
Vector non_negative(const Matrix& normal, const Vector& along);

// A Cholesky factor that is kept. Throws std::domain_error where there is none.
class Cholesky {
 public:
  explicit Cholesky(const Matrix& system);
  ~Cholesky();
  Cholesky(Cholesky&&) noexcept;
  Matrix solve(const Matrix& right) const;
  Vector solve(const Vector& right) const;

 private:
  struct Factor;
  std::shared_ptr<const Factor> factor_;
};

}  // namespace tomotactile
