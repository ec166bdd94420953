#include "tomotactile/channels.hpp"

namespace tomotactile {
namespace {

constexpr int kInColumns[4] = {0, 1, 3, 4}, kInRows[4] = {2, 3, 4, 5};  // kinds, by where they act
constexpr Index kTogether = 8;  // rows, whose derivatives stay in the cache while all parameters are gone through

}  // namespace

Slopes::Slopes(Matrix columns, Matrix in_rows, std::vector<int> rows, Index count)
    : columns_(std::move(columns)), in_rows_(std::move(in_rows)), rows_(std::move(rows)), count_(count) {}

Slopes Slopes::beside(const Vector& more) const {
  if (more.size() != in_rows_.rows()) throw BadInput("derivatives are not given for each reading");
  Matrix in_rows(in_rows_.rows(), in_rows_.cols() + 1);
  in_rows << in_rows_, more;
  return Slopes(columns_, std::move(in_rows), rows_, count_);
}

Slopes Slopes::scaled(const Vector& units) const {
  Slopes out = *this;
  for (Index l = 0; l < Index(rows_.size()); ++l) {
    for (int k = 0; k < 4; ++k)
      out.columns_.col(k).segment(count_ * l, count_).array() *= units.segment(kInColumns[k] * count_, count_).array();
    for (int k = 0; k < 3; ++k)
      out.in_rows_.col(k).segment(count_ * l, count_) *= units[kInRows[k] * count_ + rows_[l]];
  }
  return out;
}

Matrix Slopes::couplings(const Matrix& weighted) const {
  const Index scan = Index(rows_.size()), kinds_in_rows = in_rows_.cols();
  Matrix out = Matrix::Zero(kinds() * count_, weighted.cols());
  for (Index begin = 0; begin < scan; begin += kTogether)
    for (Index p = 0; p < weighted.cols(); ++p)
      for (Index l = begin; l < std::min(begin + kTogether, scan); ++l) {
        const auto mine = weighted.col(p).segment(count_ * l, count_);
        for (int k = 0; k < 4; ++k)
          out.col(p).segment(kInColumns[k] * count_, count_) += mine.cwiseProduct(columns_.col(k).segment(count_ * l, count_));
        for (Index k = 0; k < kinds_in_rows; ++k)
          out(kInRows[k] * count_ + rows_[l], p) += mine.dot(in_rows_.col(k).segment(count_ * l, count_));
      }
  return out.transpose();
}

Matrix Slopes::normal(const Matrix& weights) const {
  const Index scan = Index(rows_.size()), kinds_in_rows = in_rows_.cols(), n = count_;
  Matrix out = Matrix::Zero(kinds() * n, kinds() * n);
  for (Index l = 0; l < scan; ++l) {
    const auto weight = weights.col(l);
    const int ground = rows_[l];
    for (int i = 0; i < 4; ++i) {
      const Vector mine = weight.cwiseProduct(columns_.col(i).segment(n * l, n));
      for (int j = 0; j < 4; ++j)
        out.block(kInColumns[i] * n, kInColumns[j] * n, n, n).diagonal() += mine.cwiseProduct(columns_.col(j).segment(n * l, n));
      for (Index j = 0; j < kinds_in_rows; ++j) {
        const Vector both = mine.cwiseProduct(in_rows_.col(j).segment(n * l, n));
        out.col(kInRows[j] * n + ground).segment(kInColumns[i] * n, n) += both;
        out.row(kInRows[j] * n + ground).segment(kInColumns[i] * n, n) += both.transpose();
      }
    }
    for (Index i = 0; i < kinds_in_rows; ++i) {
      const Vector mine = weight.cwiseProduct(in_rows_.col(i).segment(n * l, n));
      for (Index j = 0; j < kinds_in_rows; ++j)
        out(kInRows[i] * n + ground, kInRows[j] * n + ground) += mine.dot(in_rows_.col(j).segment(n * l, n));
    }
  }
  return out;
}

ChannelFit::ChannelFit(const Matrix& first, const Matrix& second, const Matrix& weights, const Slopes& slopes, const Prior& prior)
    : slopes_(slopes.scaled(prior.deviation.tail(prior.deviation.size() - prior.modes))),
      scale_(prior.deviation.tail(prior.deviation.size() - prior.modes)), weights_(weights) {
  const Index modes = prior.modes, channels = scale_.size();
  mixed_.resize(first.cols() + second.cols(), channels);
  mixed_ << slopes_.couplings(first), slopes_.couplings(second);
  Matrix system = slopes_.normal(weights);
  for (Index column = 0; column < prior.precision.outerSize(); ++column)
    for (Eigen::SparseMatrix<double>::InnerIterator it(prior.precision, column); it; ++it) {
      if (column < modes) continue;
      const double value = it.value() * scale_[column - modes];
      if (it.row() < modes) {
        mixed_(first.cols() + it.row(), column - modes) += value;  // sheet against channels
      } else {
        system(it.row() - modes, column - modes) += value * scale_[it.row() - modes];
      }
    }
  if (prior.apart_in_channels) {
    const Index n = channels / kKinds;
    first_ = 2 * n;
    const Eigen::ArrayXd a = system.diagonal().head(n).array(), c = system.diagonal().segment(n, n).array();
    const Eigen::ArrayXd b = system.block(0, n, n, n).diagonal().array(), determinant = a * c - b * b;
    if (!(a > 0).all() || !(determinant > 0).all()) throw std::domain_error("a normal matrix is not positive definite");
    own_.resize(n, 3);
    own_ << c / determinant, -b / determinant, a / determinant;
    mixed_kinds_ = system.topRightCorner(first_, channels - first_);
    Matrix rest = system.bottomRightCorner(channels - first_, channels - first_);
    rest.noalias() -= mixed_kinds_.transpose() * by_channel(mixed_kinds_);
    factor_ = std::make_shared<Cholesky>(rest);
  } else {
    factor_ = std::make_shared<Cholesky>(system);
  }
  back = solve(mixed_.transpose());
  normal.noalias() = mixed_ * back;
}

Matrix ChannelFit::by_channel(const Matrix& right) const {
  const Index n = own_.rows();
  Matrix out(first_, right.cols());
  const auto gain = right.topRows(n).array(), offset = right.bottomRows(n).array();
  out.topRows(n) = (gain.colwise() * own_.col(0) + offset.colwise() * own_.col(1)).matrix();
  out.bottomRows(n) = (gain.colwise() * own_.col(1) + offset.colwise() * own_.col(2)).matrix();
  return out;
}

Matrix ChannelFit::solve(const Matrix& right) const {
  if (!first_) return factor_->solve(right);
  Matrix out(right.rows(), right.cols());
  const Matrix before = by_channel(right.topRows(first_));
  out.bottomRows(right.rows() - first_) = factor_->solve(Matrix(right.bottomRows(right.rows() - first_) - mixed_kinds_.transpose() * before));
  out.topRows(first_) = before - by_channel(mixed_kinds_ * out.bottomRows(right.rows() - first_));
  return out;
}

void ChannelFit::beside(const Matrix& columns, Matrix& mixed, Matrix& follow) const {
  mixed = slopes_.couplings(columns);
  follow = solve(mixed.transpose());
}

ChannelFit::Pulled ChannelFit::pulled(const Matrix& misfit, const Vector& pull) const {
  const Matrix weighted = weights_.cwiseProduct(misfit);
  Vector right = slopes_.couplings(Eigen::Map<const Vector>(weighted.data(), weighted.size())).transpose();
  if (pull.size()) right += scale_.cwiseProduct(pull);
  Pulled out;
  out.alone = solve(right);
  out.taken = mixed_ * out.alone;
  out.gain = right.dot(out.alone);
  return out;
}

Vector ChannelFit::step(const Vector& alone, const Vector& others) const {
  return scale_.cwiseProduct(alone - back * others);
}

}  // namespace tomotactile
