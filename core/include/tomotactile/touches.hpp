// Contacts on the sheet: H, D and what part of each patch lies where, with their derivatives.
//
// A patch on an electrode feeds the electrode and nothing else. One that a rim crosses does so in part, so that all
// derivatives exist. G between patches is taken apart into the logarithm of their distance, that to mirror images
// beyond a rim included, softened as two round clouds of charge see each other,
//
//     x^2 exp(E1(x^2 / (e^gamma r^2))) in the place of x^2,     r^2 the mean of the squared radii,
//
// the charges that it induces on electrodes (induced.hpp), a part that is smooth over the sheet, and what is
// only known of a patch with itself. Contacts 2.5 spacings and more apart do not feel each other: electrodes screen.
// Cells of one shape all do.
#pragma once

#include "tomotactile/contact.hpp"

namespace tomotactile {

constexpr double kScreened = 2.5;  // spacings between contacts beyond which D between them is nothing

// How D between p patches of a contact and m `near` it changes with places of the former, p x m, ohm/m, and what it
// falls by among themselves with the logarithm of their radii, p x p, ohm.
struct Slope {
  Matrix along_x, along_y, grown;
  std::array<Matrix, 2> steep;  // slopes of G between electrodes and the former, n x p, ohm/m
};

class Touches {
 public:
  Touches(std::shared_ptr<const Sheet> sheet, Parameters contacts, std::vector<int> across, const Vector& coefficients,
          Index cells = 0, const Touches* known = nullptr);

  // Others: of contacts that differ in their conductance only, D is known.
  std::shared_ptr<const Touches> with(const Vector& coefficients, const Parameters& contacts, const std::vector<int>& across,
                                      Index cells) const;

  Index count() const { return contacts.cols(); }
  Index patches() const { return place_.cols(); }
  Index begin(Index i) const { return begin_[i]; }
  Index size(Index i) const { return begin_[i + 1] - begin_[i]; }
  const std::vector<int>& near(Index i) const { return near_[i]; }  // patches that feel those of contact i, in order
  const std::vector<std::vector<int>>& groups() const { return groups_; }  // patches that feel each other, or through others
  const Points& places() const { return place_; }
  const Vector& radii() const { return radii_; }
  const Around& around() const { return around_; }

  std::array<Points, 5> moves(Index i) const;  // 2 x p of patches of contact i by `kMoving`
  // Change of the weights of contact i by `kMoving`, p x 5, and of what it has on electrodes, n x 5.
  void covered_change(Index i, Matrix& weight, Matrix& direct) const;
  // The same by relative changes of the pressure on its patches, p x Q.
  void pressure_change(Index i, const Matrix& pressures, Matrix& weight, Matrix& direct) const;
  // Of contact i and the patches `near` it. With E, `moves` times `slope`, less half of `grown` by the radius, D changes
  // by E + E^T.
  Slope impedance_slope(Index i) const;
  // Derivatives of `mean` of contact i by `kMoving`, ohm.
  Eigen::Matrix<double, 5, 1> mean_change(Index i, const Slope& slope) const;
  std::array<Matrix, 2> share_slopes(Index i, const Slope& slope) const;  // n x p, 1/m
  Eigen::Vector2d centre(Index i) const;  // of mass of what lies on the sheet and on electrodes in use, m
  Conductance conductance(Index i) const { return {contacts(kStrength, i), mean[i]}; }

  std::shared_ptr<const Sheet> sheet;
  Parameters contacts;
  std::vector<int> across;
  Vector coefficients;
  Matrix share;      // H, n x P
  Matrix impedance;  // D, P x P, ohm
  Vector weight;     // P: parts of a contact's area on the sheet
  Matrix direct;     // n x k: parts of each contact on electrodes
  Vector covered;    // k: the part of each that lies on the sheet and its electrodes
  Vector mean;       // k: mean D, ohm; 0 on electrodes

 private:
  std::vector<Form> forms_;
  std::vector<Index> begin_;
  Points place_;
  Vector radii_;
  Eigen::Array2Xd moving_, way_;     // 1 where a place is not held at the rim; from the nearest electrode's centre
  // where a rim crosses a patch (`crossed_`), what is left of it moves more or less, around and off, and with its size
  Eigen::ArrayXd around_rim_, off_rim_, grown_off_;
  Eigen::Array<bool, Eigen::Dynamic, 1> crossed_, bare_;
  std::vector<int> electrode_;       // nearest one, n: not in use
  Eigen::ArrayXd on_, off_, steep_radius_, rising_radius_;
  Eigen::Array2Xd steep_, rising_;
  Index cells_;                      // the last contacts, which feel each other however far apart
  std::vector<std::vector<int>> near_, groups_;
  Around around_;
  Charges charges_;
  Matrix solved_, even_, field_;     // H and D of the even sheet; k x J
  Matrix added_;                     // n x m: what an uneven sheet adds to H at the nodes of `around_`
  Matrix smooth_;                    // P x m: the smooth part of G between patches and the nodes of `around_`
  Eigen::ArrayXd factor_;            // of D for the local conductance: root of it for each patch

  void place(const Vector& area);
  void find_near();
  void connect(const Touches* known);
  void take();
};

// D between discs at places, of radii, m, as their middles have it, P x P, ohm; without what each has with itself.
Matrix mutual_impedance(const Sheet& sheet, const Points& places, const Vector& radii);

}  // namespace tomotactile
