#include <cmath>

#include "tomotactile/equations.hpp"

namespace tomotactile {
namespace {

using Point = std::shared_ptr<const Fit>;

constexpr double kConverged = 0.05;  // of the cost: a twentieth of one standard deviation squared
constexpr int kTries = 6;            // of damping in one step
// after so many tries a step that promises less of what noise does not explain is not insisted on
constexpr int kFewTries = 2;
constexpr double kLittle = 0.2;
constexpr double kNearer = 1.0;      // of the doubted cost: the whole fit takes on from there
// steps at most with the derivatives of where a step began that went too far; and from the second of them on, the
// part of the cost above that beginning which one may leave
constexpr int kChords = 5;
constexpr double kContracts = 0.5;
constexpr double kManySteps = 3.0;   // take as long as new derivatives by the contacts
// steps in turn that gain less than this part of what they promise are the last ones: they creep along a valley
constexpr int kCreeping = 2;
constexpr double kCreeps = 0.05;
constexpr double kHope = 3.0;        // times what a step gained, all that follow may gain

Point with(const Point& fit, Unknowns unknowns) { return std::make_shared<Fit>(fit->with(std::move(unknowns))); }

// Whether steps each of which leaves as much of what it promised as this one take longer to settle than new derivatives.
bool is_slow(double promised, double left, double settled) {
  if (!(settled < left && left < promised)) return left >= promised;
  return std::log(left / settled) > kManySteps * std::log(promised / left);
}

// What is better than the fit that `linear` is of. The valley of equal misfit bends: a step along it leads to a slope
// beside it, from where the same derivatives lead back (second-order correction, Nocedal and Wright 2006, chapter 15).
Point back(const Linear& linear, Point tried, int chords, double& work) {
  const Fit& fit = *linear.fit;
  for (int chord = 0; chord < chords; ++chord) {
    Point reached = with(linear.fit, linear.about(tried).step(0.0).unknowns);
    work += double(reached->prediction->work());
    if (reached->cost < fit.cost) return reached;
    if (chord && reached->cost - fit.cost > kContracts * (tried->cost - fit.cost)) break;
    tried = reached;
  }
  return nullptr;
}

struct Descent {
  Point better;  // null if there is none
  Step step;     // the last one
  double damping;
};

Descent descend(const Linear& linear, double damping, int chords, double& work) {
  const Fit& fit = *linear.fit;
  Descent out{nullptr, {}, damping};
  for (int tries = 0; tries < kTries; ++tries) {
    out.step = linear.step(out.damping);
    if (!(out.step.promised >= kConverged * fit.doubt())) break;
    if (tries >= kFewTries && out.step.promised < kLittle * (fit.chi_squared - double(fit.rows->count))) break;
    Point tried = with(linear.fit, out.step.unknowns);
    work += double(tried->prediction->work());
    if (tried->cost < fit.cost) {
      out.better = tried, out.damping /= 10;
      return out;
    }
    const double harder = std::max(out.damping, 1e-4) * 10;
    if (tries == 0) out.better = back(linear, tried, chords, work);
    out.damping = harder;
    if (out.better) return out;
  }
  return out;
}

}  // namespace

Solution approach(Point fit, double most) {
  Solution out;
  double damping = kFirstDamping;
  int creeps = 0;
  const std::shared_ptr<const Rows> rows = fit->rows;
  while (out.steps < kSteps && out.work < most && creeps < kCreeping) {
    Rows less = *rows;
    less.weights /= fit->doubt();
    const Point doubted = std::make_shared<Fit>(fit->weighed(std::make_shared<Rows>(std::move(less))));
    const Linear linear = Linear::of_contacts(doubted);
    Descent found = descend(linear, damping, 0, out.work);
    damping = found.damping;
    ++out.steps;
    if (!found.better) break;
    fit = std::make_shared<Fit>(found.better->weighed(rows));
    const double gained = doubted->cost - found.better->cost;
    creeps = gained < kCreeps * found.step.promised ? creeps + 1 : 0;
    if (std::max(gained, found.step.promised) < kNearer) break;
  }
  out.fit = fit;
  return out;
}

Solution solve(Point fit, int steps, std::shared_ptr<const Equations> known, double goal, double most) {
  Solution out;
  double damping = kFirstDamping;
  bool slow = false;
  Linear linear = Linear::of_all(fit, known);
  for (int step = 0; step < std::max(steps, 1); ++step) {
    if (step) linear = Linear::of_all(fit, known, slow ? Taken::kSheet : Taken::kServing);
    known = linear.equations;
    const Descent found = descend(linear, damping, kChords, out.work);
    damping = found.damping;
    const double gained = found.better ? fit->cost - found.better->cost : 0.0;
    if (found.better) fit = found.better;
    const double settled = kConverged * fit->doubt();
    // after a short whole step the next takes off less than what the linear model was wrong by
    const bool exact = found.step.whole && std::abs(gained - found.step.promised) < settled && known->sheet->serves(*fit);
    out.steps = step + 1;
    if (gained < settled || exact || out.work >= most) break;
    if (step && fit->cost - kHope * gained > goal) break;
    slow = found.step.whole && is_slow(found.step.promised, found.step.promised - gained, settled);
  }
  if (known->bends(*fit)) {
    linear = Linear::of_all(fit, known);
    known = linear.equations;
  }
  out.fit = fit;
  out.covariance = linear.covariance();
  out.equations = known;
  return out;
}

}  // namespace tomotactile
