#include "tomotactile/linear_algebra.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>

namespace tomotactile {
namespace {

constexpr double kRank = 1e-12;  // of the largest eigenvalue: less is rounding

}  // namespace

struct Cholesky::Factor {
  Eigen::LLT<Matrix> llt;
};

Cholesky::Cholesky(const Matrix& system) {
  auto factor = std::make_shared<Factor>();
  factor->llt.compute(system);
  if (factor->llt.info() != Eigen::Success) throw std::domain_error("a normal matrix is not positive definite");
  factor_ = std::move(factor);
}

Cholesky::~Cholesky() = default;
Cholesky::Cholesky(Cholesky&&) noexcept = default;

Matrix Cholesky::solve(const Matrix& right) const { return factor_->llt.solve(right); }

Vector Cholesky::solve(const Vector& right) const { return factor_->llt.solve(right); }

Matrix solved(const Matrix& system, const Matrix& right) {
  const Eigen::LLT<Matrix> factor(system);
  if (factor.info() == Eigen::Success) return factor.solve(right);
  return system.partialPivLu().solve(right);
}

Matrix inverse_of(const Matrix& system) {
  const Matrix out = solved(system, Matrix::Identity(system.rows(), system.cols()));
  return (out + out.transpose()) / 2;
}

Vector least_squares(const Matrix& system, const Vector& right) {
  const Eigen::SelfAdjointEigenSolver<Matrix> found(system);
  const double least = kRank * found.eigenvalues().cwiseAbs().maxCoeff();
  Vector along = found.eigenvectors().transpose() * right;
  for (Index i = 0; i < along.size(); ++i) along[i] = std::abs(found.eigenvalues()[i]) > least ? along[i] / found.eigenvalues()[i] : 0.0;
  return found.eigenvectors() * along;
}

}  // namespace tomotactile
