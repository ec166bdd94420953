#include "tomotactile/outline.hpp"

#include <cmath>
#include <limits>

namespace tomotactile {
namespace {

// Takes a rim into account that is `distance` away in the direction `out` (a unit vector, or 0 on the rim itself).
struct Nearest {
  double distance = std::numeric_limits<double>::infinity();
  Eigen::Vector2d away = Eigen::Vector2d::Zero();  // from the rim to the place, unit length

  void meet(double d, const Eigen::Vector2d& unit) {
    if (d < distance) distance = d, away = unit;
  }
};

// Nearest point of a closed ring, and whether the place is inside of it (even-odd rule).
bool meet_ring(const Points& ring, const Eigen::Vector2d& place, Nearest& nearest) {
  bool inside = false;
  const Index count = ring.cols();
  for (Index i = 0, j = count - 1; i < count; j = i++) {
    const Eigen::Vector2d a = ring.col(j), side = ring.col(i) - a, way = place - a;
    const double length = side.squaredNorm();
    const double part = length > 0 ? std::min(std::max(way.dot(side) / length, 0.0), 1.0) : 0.0;
    const Eigen::Vector2d from = way - part * side;
    const double distance = from.norm();
    const Eigen::Vector2d normal(side.y(), -side.x());
    nearest.meet(distance, distance > 0 ? Eigen::Vector2d(from / distance)
                                        : Eigen::Vector2d(normal / std::max(normal.norm(), 1e-300)));
    const bool above = ring(1, i) > place.y(), other = ring(1, j) > place.y();
    if (above != other) {
      const double x = a.x() + (place.y() - a.y()) / side.y() * side.x();
      if (place.x() < x) inside = !inside;
    }
  }
  return inside;
}

}  // namespace

void Outline::depth(const Points& places, Vector& deep, Points& inwards) const {
  deep.resize(places.cols());
  inwards.setZero(2, places.cols());
  for (Index p = 0; p < places.cols(); ++p) {
    const Eigen::Vector2d place = places.col(p);
    if (rectangle) {
      const Eigen::Vector2d inside = 0.5 * size - place.cwiseAbs();
      const Index axis = inside.y() < inside.x() ? 1 : 0;
      deep[p] = inside[axis];
      inwards(axis, p) = place[axis] > 0 ? -1.0 : place[axis] < 0 ? 1.0 : 0.0;
      continue;
    }
    Nearest nearest;
    bool inside = true;
    std::size_t first = 0;
    if (circle > 0) {
      const double far = place.norm();
      inside = far <= circle;
      const Eigen::Vector2d out = far > 0 ? Eigen::Vector2d(place / far) : Eigen::Vector2d(1, 0);
      nearest.meet(std::abs(circle - far), inside ? Eigen::Vector2d(-out) : out);
    } else if (!rings.empty()) {
      inside = meet_ring(rings[0], place, nearest);
      first = 1;
    }
    for (std::size_t hole = first; hole < rings.size(); ++hole)
      if (meet_ring(rings[hole], place, nearest)) inside = false;
    deep[p] = inside ? nearest.distance : -nearest.distance;
    inwards.col(p) = inside ? nearest.away : Eigen::Vector2d(-nearest.away);
  }
}

}  // namespace tomotactile
