// Gains, offsets, resistances to ground and places of electrodes as unknowns of the fit, eliminated before anything is
// solved (Schur complement).
//
// They outnumber all else (five a channel), but each touches one column or one row of the readings only: the blocks
// of their normal matrix are diagonal, but for what acts on columns against what acts on rows.
#pragma once

#include "tomotactile/linear_algebra.hpp"
#include "tomotactile/prior.hpp"

namespace tomotactile {

// Derivatives of the readings (nL) by the channels: by gain, offset and both ways aside of the electrode that is read
// (`columns`); by resistance and both ways aside of the one that is grounded (`in_rows`), and by what else may act on
// rows, which counts as a kind more.
class Slopes {
 public:
  Slopes(Matrix columns, Matrix in_rows, std::vector<int> rows, Index count);

  Index kinds() const { return kKinds + in_rows_.cols() - 3; }
  Index count() const { return count_; }
  const Matrix& in_columns() const { return columns_; }
  const Matrix& in_rows() const { return in_rows_; }
  Slopes beside(const Vector& in_rows) const;
  Slopes scaled(const Vector& units) const;  // 5 n
  Matrix couplings(const Matrix& weighted) const;  // nL x P, times the weights -> P x kinds n
  Matrix normal(const Matrix& weights) const;      // kinds n x kinds n

 private:
  Matrix columns_, in_rows_;
  std::vector<int> rows_;
  Index count_;
};

// The channels' part of the normal equations of one linearisation.
class ChannelFit {
 public:
  // first, second: nL x F and nL x J derivatives by contacts and by the sheet, times the weights
  ChannelFit(const Matrix& first, const Matrix& second, const Matrix& weights, const Slopes& slopes, const Prior& prior);

  // Of more parameters, nL x m times the weights: what couples them to the channels, and how these follow them.
  void beside(const Matrix& columns, Matrix& mixed, Matrix& back) const;

  struct Pulled {
    Vector alone;  // steps of the channels if nothing else moves, in units of their own
    Vector taken;  // what that takes off the right side of all else
    double gain;   // off the cost
  };
  Pulled pulled(const Matrix& misfit, const Vector& pull) const;
  Vector step(const Vector& alone, const Vector& others) const;  // 5 n

  Matrix normal;  // P x P: what the channels take off the normal matrix of all else
  Matrix back;    // 5 n x P: how they follow all else, in units of their own

 private:
  Slopes slopes_;
  Vector scale_;
  Matrix weights_, mixed_;
  // Gains and offsets are solved channel by channel (2 x 2) where nothing couples those of different channels, and the
  // other kinds after them (Schur complement); else all together.
  Index first_ = 0;              // unknowns that are solved channel by channel: 2 n or 0
  Eigen::ArrayX3d own_;          // n x 3: inverse of the 2 x 2 blocks, 11, 12, 22
  Matrix mixed_kinds_;           // first_ x rest
  std::shared_ptr<const Cholesky> factor_;

  Matrix by_channel(const Matrix& right) const;  // the inverse of the blocks times first_ x m
  Matrix solve(const Matrix& right) const;       // 5 n x m
};

}  // namespace tomotactile
