#include "tomotactile/follow.hpp"

#include <algorithm>
#include <cmath>

#include "tomotactile/equations.hpp"
#include "tomotactile/outliers.hpp"

namespace tomotactile {
namespace {

constexpr double kEvent = 1e-3;  // probability that a contact begins or ends in a given row: one event a second
const double kCost = -2 * std::log(kEvent);  // of such an event, in units of chi-squared
constexpr double kCalming = 0.9;  // part of the surprises that the next row remembers: ten rows
constexpr double kConfused = 2.8; // surprises of late: one touch or its end makes two; more, and rows are not believed
// m, m/s and of ln c: what may change from one row to the next, standard deviations
const Eigen::Matrix<double, kState, 1> kLoose = (Eigen::Matrix<double, kState, 1>() << 1e-3, 1e-3, 1.0, 1.0, 1.0).finished();
constexpr double kNewStrength = 5.0;  // of ln c: nothing is known of a new one
constexpr double kFading = 0.05;      // s of fading that are made up for at once: a thousandth of it
constexpr int kOften = 8, kFirstSteps = 2;  // of a fit at the most; of each of several starts
constexpr int kWithout = 3;           // of one without a contact, which began where it is
constexpr double kGone = 3.0;         // standard deviations of ln c: below, it is not known that a contact conducts
constexpr double kBeside = 1.0;       // spacings from the rim of a wide contact within which nothing begins
constexpr int kRested = 128;          // rows: those of what has not come since, nor moves, hardly tell of the sensor
// of other rows that do; golden section: all electrodes' in turn
constexpr double kPart = 0.25, kPattern = 0.6180339887;
constexpr double kMostDistrusted = 0.25;  // of the channels: if rows contradict so many, they are not believed
// contacts that may begin in one row. Of 16 scenes in which two touches of 1 N begin in the same row beside a resting one,
// all rows were withheld until the frame with 1, and 24 of 1,024 are with 2; 3 are no better
constexpr int kTogether = 2;
// rows that all contacts must have been there for that. Of 16 scenes each with two and three touches of 1 N that begin in
// the same row on an untouched sheet, 200 of 2,048 rows show a contact that is none, and 449 would from 0 rows on
constexpr int kSure = 3;
// events in one row, at most: contacts that begin or end, and readings that are wrong (two exchanged wires, and another).
// With more, a touch on a sensor of which only four channels of 16 read anything was two others
constexpr int kAtOnce = 3;
constexpr double kAcross = 0.3;  // spacings from an electrode within which all of its sides are tried
constexpr double kClose = 1.0;   // sum of radii: contacts nearer to each other are one

bool is_idle(const RowFit& fit) { return std::isinf(fit.row.own); }

// Whether a row is to tell of the sensor: those of contacts that have come or move do, of resting ones each fourth, in a
// pattern that meets all electrodes.
bool learns(const Belief& belief, int number) {
  int least = belief.count() ? belief.rows[0] : 0;
  for (Index i = 0; i < belief.count(); ++i) {
    if (belief.mean.segment<2>(kState * i + 2).squaredNorm() > kSlow * kSlow) return true;
    least = std::min(least, belief.rows[i]);
  }
  return least < kRested || std::fmod(number * kPattern, 1.0) < kPart;
}

// Chi-squared of an untouched sheet, whose readings are independent, without those that contradict most: what remains of
// it whichever are wrong.
double at_least(const RowFit& untouched) {
  std::vector<double> each(untouched.misfit.size());
  for (std::size_t e = 0; e < each.size(); ++e) each[e] = std::pow(untouched.misfit[e] / untouched.root(e, e), 2);
  std::sort(each.begin(), each.end());
  double out = 0;
  for (int e = 0; e < int(each.size()) - kAtOnce; ++e) out += each[e];
  return out;
}

}  // namespace

Follower::Follower(std::shared_ptr<const Sheet> sheet, Points places, double threshold, double radius, double spread, double rate,
                   Matrix limits)
    : sheet_(sheet), births_(sheet, std::move(places), radius, threshold), size_(std::log(radius), spread * spread), rate_(rate),
      limits_(std::move(limits)) {
  if (limits_.rows() != 3 || limits_.cols() != sheet_->count()) throw BadInput("limits: three for each number of readings are needed");
}

void Follower::Reading::leave_out(const std::vector<int>& which) {
  for (int each : which) readings[each] = 0.0, valid[each] = false;
}

Follower::Reading Follower::begin(RowState& state, const Vector& readings, const Read& valid) const {
  const Index n = sheet_->count();
  if (!state.belief || !state.model || state.model->count() != n || Index(state.distrusted.size()) != n)
    throw BadInput("what lasts from row to row does not fit the electrodes");
  state.belief->check();
  if (readings.size() != n || Index(valid.size()) != n) throw BadInput("a row does not fit the electrodes");
  Reading read{readings, valid, 0};
  for (Index e = 0; e < n; ++e) {
    state.distrusted[e] = std::max(state.distrusted[e] - 1, 0);
    if (state.distrusted[e]) read.valid[e] = false;
    if (!read.valid[e]) read.readings[e] = 0.0;
    read.count += read.valid[e];
  }
  if (!read.readings.allFinite()) throw BadInput("readings of a row are not finite");
  read.count = std::max<Index>(read.count, 1);
  return read;
}

RowState Follower::follow(RowState state, const Vector& readings, const Read& valid, Index ground, double time) const {
  if (ground < 0 || ground >= sheet_->count()) throw BadInput("the grounded electrode is none of those in use");
  const double lasts = std::isfinite(state.time) ? std::max(time - state.time, 0.0) : 0.0;
  const Reading read = begin(state, readings, valid);
  const RowModel& model = *state.model;
  state.time = time, state.unfaded += lasts;
  const double faded = state.unfaded > kFading ? state.unfaded : 0.0;
  state.unfaded -= faded;
  const auto expected = std::make_shared<const Belief>(state.belief->later(lasts, model.deviation(), faded));
  const int steps = is_linear(*expected) ? 1 : kOften;
  Seen seen = fitted(model, expected, read, ground, steps, nullptr, learns(*expected, state.read));
  const double surprising = limits_(0, read.count - 1), confusing = limits_(1, read.count - 1);
  const double unexplained = limits_(2, read.count - 1);
  state.confused *= kCalming;
  if (seen.fit.chi_squared > surprising) {
    const bool confuses = seen.fit.chi_squared > confusing;
    seen = explained(state, expected, seen, read, ground, surprising);
    const int n = int(valid.size());
    const bool left_out = std::count(state.distrusted.begin(), state.distrusted.end(), n) > 0;  // in this row
    state.confused += confuses * (1 + (seen.fit.chi_squared > confusing)) + left_out;
    const auto doubted = n - std::count(state.distrusted.begin(), state.distrusted.end(), 0);
    // what rows say from here on rests on what was wrong
    if (state.confused > kConfused || doubted >= kMostDistrusted * n) state.confused = std::numeric_limits<double>::infinity();
  } else {
    state.sums.resize(0, 0);
    if (expected->count() && !model.wide().cols()) {  // what a multiplexer that settles slowly leaves of a touch surprises nobody
      Seen none = gone(model, *expected, read);
      if (none.cost + kCost < seen.cost) seen = std::move(none);
    }
    seen = ended(state, std::move(seen), read, ground);
  }
  state.unexplained = seen.fit.chi_squared > unexplained ? state.unexplained + 1 : 0;
  state.belief = std::make_shared<const Belief>(believed(seen, model));
  passed(state, is_idle(seen.fit), seen.fit.chi_squared / read.count);
  return state;
}

RowState Follower::wait(RowState state, const Vector& readings, const Read& valid, double time) const {
  Reading read = begin(state, readings, valid);
  state.time = time, state.unexplained = 0;
  const bool any = std::find(read.valid.begin(), read.valid.end(), true) != read.valid.end();
  const double most = limits_(0, read.count - 1);
  Seen none = gone(*state.model, *state.belief, read);
  if (none.fit.chi_squared > most && most >= at_least(none.fit)) {  // maybe a few readings are wrong
    const std::vector<int> left = outliers(none.fit.misfit, none.fit.root, read.valid, kAtOnce).found;
    read.leave_out(left);
    none = gone(*state.model, *state.belief, read);
    if (none.fit.chi_squared <= most)
      for (int each : left) state.distrusted[each] = int(valid.size());
  }
  const bool untouched = any && none.fit.chi_squared <= most;
  if (untouched) state.belief = std::make_shared<const Belief>(believed(none, *state.model));
  passed(state, untouched, none.fit.chi_squared / read.count);
  return state;
}

// What a row that was taken in leaves.
void Follower::passed(RowState& state, bool untouched, double misfit) const {
  state.untouched = untouched, state.misfit = misfit;
  if (untouched)
    state.confused = 0.0, state.touched_at_once = false;
  else if (!state.read)  // a row tells one contact from several only where one comes at a time
    state.confused = std::numeric_limits<double>::infinity(), state.touched_at_once = true;
  ++state.read;
}

// The belief after the row, linearised `steps` times at the most, about `start` first; of the contacts alone where the row
// is not to tell of the sensor.
Follower::Seen Follower::fitted(const RowModel& model, const Prior& prior, const Reading& read, Index ground, int steps,
                                const Vector* start, bool learns) const {
  const Matrix mutual = prior->count() > 1 ? model.mutual(prior->contacts(start ? *start : prior->mean)) : Matrix();
  return {prior, model.fit(prior->mean, prior->covariance, prior->sizes.row(0).transpose(), mutual, read.readings, read.valid, ground,
                           steps, start, learns)};
}

// Nothing touches and drives the sheet: all that is read are offsets and noise, and nothing is learned.
Follower::Seen Follower::idle(const RowModel& model, const Prior& prior, const Reading& read) const {
  return {prior, model.idle_fit(prior->mean, read.readings, read.valid)};
}

// Nothing touches any more, nor anything wide.
Follower::Seen Follower::gone(const RowModel& model, const Belief& belief, const Reading& read) const {
  return idle(model, std::make_shared<const Belief>(belief.of_sensor()), read);
}

// The same, or without the contacts that have gone: one that is let go ever more softly surprises nobody either, but what
// was left of it is not there in one row after the other.
Follower::Seen Follower::ended(RowState& state, Seen seen, const Reading& read, Index ground) const {
  std::map<int, double> spent;
  for (Index i = seen.prior->count() - 1; i >= 0; --i) {
    const Belief& prior = *seen.prior;
    const Index at = kState * i + 4;
    const auto known = state.fading.find(prior.numbers[i]);
    const double before = known == state.fading.end() ? 0.0 : known->second, fallen = prior.mean[at] - seen.fit.mean[at];
    if (!(before > 0) && (fallen < 0 || fallen * fallen < prior.covariance(at, at))) continue;
    const int number = prior.numbers[i];
    Seen rest = fitted(*state.model, std::make_shared<const Belief>(prior.without(i)), read, ground, kFirstSteps);
    const double gained = before + seen.cost - rest.cost;
    if (gained > kCost) seen = std::move(rest);
    else if (gained > 0) spent[number] = gained;
  }
  state.fading = std::move(spent);
  return seen;
}

// Whether contacts are known to where one linearisation holds: they are not after a pause.
bool Follower::is_linear(const Belief& belief) const {
  const double most = std::pow(kReach * sheet_->tables().pitch, 2);
  for (Index i = 0; i < belief.count(); ++i)
    if (!(belief.covariance.diagonal().segment<2>(kState * i).array() < most).all()) return false;
  return true;
}

// The likeliest of what may have happened; `surprising`: chi-squared from which on a row is.
Follower::Seen Follower::explained(RowState& state, const Prior& expected, const Seen& plain, const Reading& read, Index ground,
                                   double surprising) const {
  const RowModel& model = *state.model;
  std::vector<std::pair<int, Seen>> tried{{0, plain}};  // events, and what then was
  const Index count = expected->count();
  std::vector<Seen> found;
  int least = count ? *std::min_element(expected->rows.begin(), expected->rows.end()) : 0;
  if (count) {
    const auto loose = std::make_shared<const Belief>(expected->loosened(kLoose.cwiseAbs2()));
    tried.emplace_back(0, fitted(model, loose, read, ground, kOften));
    std::vector<Prior> left;
    for (Index i = 0; i < count; ++i) left.push_back(std::make_shared<const Belief>(expected->without(i)));
    for (const Prior& rest : left) tried.emplace_back(1, fitted(model, rest, read, ground, kWithout));
    if (count > 1) tried.emplace_back(1, gone(model, *expected, read));
    for (Index i = 0; i < count; ++i) {
      if (expected->rows[i] >= kYoung) continue;
      const Seen before = fitted(model, left[i], read, ground, 1);
      found.clear();
      born(state, left[i], before, read, ground, false, expected->numbers[i], expected->begun[i], found);
      for (Seen& each : found) tried.emplace_back(2, std::move(each));
    }
  }
  if (model.wide().cols()) tried.emplace_back(1, gone(model, *expected, read));
  Seen base = plain;
  const int most = least >= kSure ? kTogether : 1;  // on an untouched sheet one contact may explain what several do
  for (int number = 1; number <= most; ++number) {
    found.clear();
    born(state, base.prior, base, read, ground, number == 1, state.last + number, state.time, found);
    if (found.empty()) break;
    base = *std::min_element(found.begin(), found.end(), [](const Seen& a, const Seen& b) { return a.cost < b.cost; });
    for (Seen& each : found) tried.emplace_back(number, std::move(each));
    if (base.fit.chi_squared < surprising) break;
  }
  Seen best = trusted(state, tried, read, ground);
  const std::vector<int>& numbers = best.prior->numbers;
  const int last = numbers.empty() ? 0 : *std::max_element(numbers.begin(), numbers.end());
  if (last > state.last) state.last = last, state.sums.resize(0, 0);
  return best;
}

// The likeliest, without readings that are rather wrong. Those are not read for a frame, which can tell.
Follower::Seen Follower::trusted(RowState& state, std::vector<std::pair<int, Seen>>& tried, const Reading& read, Index ground) const {
  double least = std::numeric_limits<double>::infinity();
  std::size_t likeliest = 0;
  std::vector<int> wrong;
  for (std::size_t i = 0; i < tried.size(); ++i) {
    const auto& [events, seen] = tried[i];
    const Outliers left = outliers(seen.fit.misfit, seen.fit.root, read.valid, kAtOnce - events);
    const double cost = seen.cost + events * kCost - left.gained;
    if (cost < least) least = cost, likeliest = i, wrong = left.found;
  }
  Seen best = std::move(tried[likeliest].second);
  if (wrong.empty()) return best;
  for (int each : wrong) state.distrusted[each] = int(read.valid.size());
  Reading rest = read;
  rest.leave_out(wrong);
  if (is_idle(best.fit)) return idle(*state.model, best.prior, rest);
  return fitted(*state.model, best.prior, rest, ground, kOften, &best.fit.mean);
}

// Fits of `belief` and one contact more, with that number and since then, where the row asks for it: where `before`, a fit
// of that belief, does not explain it. `sums`: whether with the rows before.
void Follower::born(RowState& state, const Prior& belief, const Seen& before, const Reading& read, Index ground, bool sums, int number,
                    double begun, std::vector<Seen>& out) const {
  const RowModel& model = *state.model;
  Matrix none = births_.nothing();
  if (sums && !state.sums.size()) state.sums = births_.nothing();
  const Births::Gains gains = births_.look(state.model, before.fit, ground, sums ? state.sums : none);
  if (!gains.any) return;
  const Eigen::Vector2d side = sheet_->tables().outline.size;
  Eigen::Matrix<double, kState, 1> deviations, mean;
  deviations << side, rate_, rate_, kNewStrength;
  const Index at = kState * belief->count();
  Seen best;
  for (const Eigen::Vector3d& start : births_.starts(gains)) {
    if (taken(*belief, model, start.head<2>())) continue;
    mean << start.head<2>(), 0.0, 0.0, start[2];
    const auto prior = std::make_shared<const Belief>(
        belief->with_contact(mean, deviations.cwiseAbs2().asDiagonal().toDenseMatrix(), size_, number, begun));
    Vector from(prior->mean.size());
    from << before.fit.mean.head(at), mean, before.fit.mean.tail(before.fit.mean.size() - at);
    Seen found = fitted(model, prior, read, ground, kFirstSteps, &from);
    if (!best.prior || found.cost < best.cost) best = std::move(found);
  }
  if (!best.prior) return;
  out.push_back(fitted(model, best.prior, read, ground, kOften, &best.fit.mean));
  Seen nearest;
  for (const Vector& from : across(model, out.back())) {
    Seen found = fitted(model, best.prior, read, ground, kFirstSteps, &from);
    if (!nearest.prior || found.cost < nearest.cost) nearest = std::move(found);
  }
  if (nearest.prior) out.push_back(fitted(model, best.prior, read, ground, kOften, &nearest.fit.mean));
}

// The state with its last contact on the three other sides of the electrode next to it: one row hardly tells which side it
// is. None of them where no electrode is near.
std::vector<Vector> Follower::across(const RowModel& model, const Seen& seen) const {
  const Tables& t = sheet_->tables();
  const Index count = seen.prior->count(), at = kState * (count - 1);
  const Eigen::Vector2d place = seen.fit.mean.segment<2>(at);
  Index which;
  const double distance = std::sqrt((t.centres.colwise() - place).colwise().squaredNorm().minCoeff(&which));
  std::vector<Vector> out;
  if (distance > kAcross * t.pitch) return out;
  const Eigen::Vector2d way = place - t.centres.col(which), turned(-way.y(), way.x());
  for (const Eigen::Vector2d& side : {Eigen::Vector2d(-way), turned, Eigen::Vector2d(-turned)}) {
    Vector mean = seen.fit.mean;
    mean.segment<2>(at) = t.centres.col(which) + side;
    out.push_back(model.limited(mean, mean, count));
  }
  return out;
}

// Whether what is new there is one of the contacts, or may be a change of a wide one: frames tell them apart.
bool Follower::taken(const Belief& belief, const RowModel& model, const Eigen::Vector2d& place) const {
  const Discs small = belief.contacts(), &wide = model.wide();
  for (Index i = 0; i < small.cols(); ++i)
    if ((small.block<2, 1>(0, i) - place).norm() < kClose * (std::exp(small(3, i)) + std::exp(size_[0]))) return true;
  for (Index i = 0; i < wide.cols(); ++i)
    if ((wide.block<2, 1>(0, i) - place).norm() < kBeside * sheet_->tables().pitch + std::exp(wide(3, i))) return true;
  return false;
}

// The belief after the row, without contacts of which it is no longer known that they conduct, and of which two are one.
// One that no row of late was near may conduct anything, and is there until a row that would show it does not.
Belief Follower::believed(const Seen& seen, const RowModel& model) const {
  const double faint = model.faintest() + std::log(kGone);
  Belief out = *seen.prior;
  out.mean = seen.fit.mean;
  seen.fit.correct(out.covariance);
  for (int& rows : out.rows) ++rows;
  for (Index i = out.count() - 1; i >= 0; --i) {
    const Index at = kState * i + 4;
    const bool young = out.rows[i] < kYoung && out.rows[i] > 1;
    if (out.covariance(at, at) > 1 / (kGone * kGone) && (young || out.mean[at] < faint)) out = out.without(i);
  }
  for (Index i = out.count() - 1; i >= 1; --i)
    for (Index j = 0; j < i; ++j)
      if ((out.mean.segment<2>(kState * j) - out.mean.segment<2>(kState * i)).norm() < kClose * std::exp(out.sizes(0, j))) {
        out = out.without(i);
        break;
      }
  return out;
}

}  // namespace tomotactile
