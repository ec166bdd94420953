// Contacts row by row: the recursive form of the estimate, one row after the other.
//
// The belief about contacts and sensor is brought to the time of a row and corrected by its readings (rows.hpp). A row that
// the expected contacts do not explain is looked at again: contacts may have moved or changed at once, one or all of them
// have gone, one has come, or one that has just come was somewhere else; and with each of these, some readings may be
// wrong (outliers.hpp). Of these the likeliest is believed, -2 ln(likelihood) with the belief marginal, and what begins or
// ends costs in addition what its prior probability says. One that comes must, besides, exceed what noise does anywhere
// on the lattice (births.hpp).
#pragma once

#include <limits>
#include <map>

#include "tomotactile/belief.hpp"
#include "tomotactile/births.hpp"

namespace tomotactile {

constexpr int kYoung = 12;  // rows within which a new contact may turn out to be elsewhere

// All that lasts from row to row; a new one begins anew.
struct RowState {
  std::shared_ptr<const Belief> belief;
  std::shared_ptr<const RowModel> model;
  Matrix sums;                    // of the matched filter; none: before any row
  std::vector<int> distrusted;    // n: rows for which a reading is not believed
  double time = -std::numeric_limits<double>::infinity();  // s, of the last row
  int last = 0;                   // highest number given
  int unexplained = 0;            // rows in a row that no contacts explain
  double confused = 0;            // surprising rows of late; infinite when there were too many, or where something touched
                                  // already in the first row, until a frame or an untouched row tells
  double unfaded = 0;             // s for which what rows say of the sensor has not faded yet
  bool untouched = false;         // whether the last row is that of an untouched sheet
  double misfit = 0;              // chi-squared per reading of the last row, against what was expected of it
  int read = 0;                   // rows so far
  bool touched_at_once = false;   // whether the first row confused
  std::map<int, double> fading;   // how much likelier rows of late are without a contact, by its number
};

class Follower {
 public:
  // `spread`: standard deviation of the logarithm of radii, m; `rate`: m/s, of velocities; `limits` (3 x n): chi-squared of
  // so many readings (1 ... n) from which on a row is surprising, confusing, unexplained.
  Follower(std::shared_ptr<const Sheet> sheet, Points places, double threshold, double radius, double spread, double rate,
           Matrix limits);

  // The state after a row: `readings` (n), parts of V0, of which some are `valid`; the grounded electrode; s, not before
  // that of the row before.
  RowState follow(RowState state, const Vector& readings, const Read& valid, Index ground, double time) const;
  // The same of a row that is not believed, as a frame has to tell first: all that it says is whether anything touches.
  RowState wait(RowState state, const Vector& readings, const Read& valid, double time) const;

 private:
  using Prior = std::shared_ptr<const Belief>;
  struct Seen {  // how likely a row was, and the belief before it
    Prior prior;
    RowFit fit;
    double cost = 0;
    Seen(Prior before, RowFit found) : prior(std::move(before)), fit(std::move(found)), cost(fit.cost()) {}
    Seen() = default;
  };
  struct Reading {
    Vector readings;  // 0 where not valid
    Read valid;
    Index count;      // of them, 1 at least
    void leave_out(const std::vector<int>& which);
  };
  std::shared_ptr<const Sheet> sheet_;
  Births births_;
  Eigen::Vector2d size_;
  double rate_;
  Matrix limits_;

  Reading begin(RowState& state, const Vector& readings, const Read& valid) const;
  void passed(RowState& state, bool untouched, double misfit) const;
  Seen fitted(const RowModel& model, const Prior& prior, const Reading& read, Index ground, int steps, const Vector* start = nullptr,
              bool learns = true) const;
  Seen idle(const RowModel& model, const Prior& prior, const Reading& read) const;
  Seen gone(const RowModel& model, const Belief& belief, const Reading& read) const;
  Seen ended(RowState& state, Seen seen, const Reading& read, Index ground) const;
  Seen explained(RowState& state, const Prior& expected, const Seen& plain, const Reading& read, Index ground, double surprising) const;
  Seen trusted(RowState& state, std::vector<std::pair<int, Seen>>& tried, const Reading& read, Index ground) const;
  void born(RowState& state, const Prior& belief, const Seen& before, const Reading& read, Index ground, bool sums, int number,
            double begun, std::vector<Seen>& out) const;
  std::vector<Vector> across(const RowModel& model, const Seen& seen) const;
  bool is_linear(const Belief& belief) const;
  bool taken(const Belief& belief, const RowModel& model, const Eigen::Vector2d& place) const;
  Belief believed(const Seen& seen, const RowModel& model) const;
};

}  // namespace tomotactile
