#include "tomotactile/linear_algebra.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>

namespace tomotactile {
namespace {

constexpr double kRank = 1e-12;  // of the largest eigenvalue: less is rounding
constexpr double kFlat = 1e-11;  // of the largest slope: less is rounding

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
  if (!right.size() || !system.allFinite() || !right.allFinite()) return Vector::Zero(right.size());
  const Eigen::SelfAdjointEigenSolver<Matrix> found(system);
  const double least = kRank * found.eigenvalues().cwiseAbs().maxCoeff();
  Vector along = found.eigenvectors().transpose() * right;
  for (Index i = 0; i < along.size(); ++i) along[i] = std::abs(found.eigenvalues()[i]) > least ? along[i] / found.eigenvalues()[i] : 0.0;
  return found.eigenvectors() * along;
}

Vector non_negative(const Matrix& normal, const Vector& along) {
  const Index count = along.size();
  if (normal.rows() != count || normal.cols() != count) throw BadInput("normal matrix and right side differ in size");
  const Vector scale = normal.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Matrix system = scale.asDiagonal() * normal * scale.asDiagonal();
  const Vector right = scale.cwiseProduct(along);
  Vector x = Vector::Zero(count);
  if (!count) return x;
  std::vector<int> free, barred;  // the latter by rounding: they would leave at once
  const double least = kFlat * right.cwiseAbs().maxCoeff();
  for (Index turn = 0; turn < 30 * count; ++turn) {
    Vector slope = right - system * x;
    for (int each : free) slope[each] = 0;
    for (int each : barred) slope[each] = 0;
    Index best;
    if (!(slope.maxCoeff(&best) > least)) return scale.cwiseProduct(x);
    free.push_back(int(best));
    while (!free.empty()) {
      const Vector found = solved(system(free, free), right(free));
      double part = 1;
      for (std::size_t i = 0; i < free.size(); ++i)
        if (!(found[Index(i)] > 0)) part = std::min(part, x[free[i]] / (x[free[i]] - found[Index(i)]));
      if (!(part >= 0)) part = 0;
      std::vector<int> kept;
      for (std::size_t i = 0; i < free.size(); ++i) {
        double& value = x[free[i]];
        value += part * (found[Index(i)] - value);
        if (part == 1 || (found[Index(i)] > 0 && value > 0) || value > kRank) kept.push_back(free[i]);
        else value = 0;
      }
      if (kept.size() == free.size()) break;
      free = kept;
    }
    if (!free.empty() && free.back() == int(best)) barred.clear();
    else barred.push_back(int(best));
  }
  throw std::domain_error("conductances that are not negative were not found");
}

}  // namespace tomotactile
