// Arrays in, arrays out: what Python needs of the core. Nothing is computed here.
//
// Arrays are those of Python, (k, 6), (L, n), (P, L, n): in C order they are the columns of the core. Whatever does not
// fit is refused with one line (BadInput becomes ValueError, no factorisation numpy.linalg.LinAlgError); the GIL is
// released while something is worked out.
#include <numeric>

#include <pybind11/complex.h>
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "tomotactile/equations.hpp"
#include "tomotactile/first_look.hpp"
#include "tomotactile/follow.hpp"
#include "tomotactile/linear_algebra.hpp"
#include "tomotactile/outliers.hpp"
#include "tomotactile/rows.hpp"

namespace py = pybind11;
using namespace py::literals;
using namespace tomotactile;

namespace {

using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Integers = py::array_t<int, py::array::c_style | py::array::forcecast>;
using Booleans = py::array_t<bool, py::array::c_style | py::array::forcecast>;
using Free = py::gil_scoped_release;

[[noreturn]] void refuse(const char* name, const char* wanted) {
  throw BadInput(std::string(name) + ": an array " + wanted + " is needed");
}

// (columns, rows) of Python as rows x columns.
template <class Out = Matrix>
Out matrix(const Array& a, const char* name, Index rows = -1) {
  const Index columns = Out::ColsAtCompileTime;
  if (a.ndim() != 2 || (rows >= 0 && a.shape(1) != rows) || (columns != Eigen::Dynamic && a.shape(0) != columns))
    refuse(name, "of two dimensions that fits the others");
  Out out(a.shape(1), a.shape(0));
  std::copy(a.data(), a.data() + a.size(), out.data());
  return out;
}

Vector vector(const Array& a, const char* name) {
  if (a.ndim() != 1) refuse(name, "of one dimension");
  return Eigen::Map<const Vector>(a.data(), a.size());
}

std::vector<int> integers(const Integers& a, const char* name) {
  if (a.ndim() != 1) refuse(name, "of whole numbers of one dimension");
  return std::vector<int>(a.data(), a.data() + a.size());
}

// (m, a, b) of Python as m matrices b x a.
std::vector<Matrix> matrices(const Array& a, const char* name) {
  if (a.ndim() != 3) refuse(name, "of three dimensions");
  std::vector<Matrix> out;
  for (Index m = 0; m < a.shape(0); ++m) {
    const double* first = a.data() + m * a.shape(1) * a.shape(2);
    out.push_back(Eigen::Map<const Matrix>(first, a.shape(2), a.shape(1)));
  }
  return out;
}

// Matrices side by side, or each below the one before.
Matrix beside(const std::vector<Matrix>& each, bool below = false) {
  const Index rows = each.empty() ? 0 : each[0].rows(), columns = each.empty() ? 0 : each[0].cols(), count = Index(each.size());
  Matrix out(below ? rows * count : rows, below ? columns : columns * count);
  for (Index j = 0; j < count; ++j) out.block(below ? rows * j : 0, below ? 0 : columns * j, rows, columns) = each[j];
  return out;
}

std::array<Matrix, 2> two(const Array& a, const char* name) {
  std::vector<Matrix> found = matrices(a, name);
  if (found.size() != 2) refuse(name, "of two matrices");
  return {found[0].transpose(), found[1].transpose()};
}

Array array(std::vector<py::ssize_t> shape, const double* data) {
  Array out(shape);
  std::copy(data, data + out.size(), out.mutable_data());
  return out;
}

Array array(const Matrix& m) { return array({m.cols(), m.rows()}, m.data()); }
Array array(const Points& m) { return array({m.cols(), 2}, m.data()); }
Array array(const Vector& v) { return array({v.size()}, v.data()); }

// nL x P as (P, L, n), or as (P, L n).
Array columns(const Matrix& m, Index n) { return array({m.cols(), n ? m.rows() / n : 0, n}, m.data()); }

Mask free_of(const Booleans& free, Index count) {
  if (free.ndim() != 2 || free.shape(1) != 6 || (count >= 0 && free.shape(0) != count)) refuse("free", "(k, 6)");
  Mask out(6, free.shape(0));
  std::copy(free.data(), free.data() + free.size(), out.data());
  return out;
}

Unknowns unknowns(const py::object& of) {
  Unknowns u;
  u.contacts = matrix<Parameters>(of.attr("contacts").cast<Array>(), "contacts", 6);
  u.free = free_of(of.attr("free").cast<Booleans>(), -1);
  u.across = of.attr("across").cast<std::vector<int>>();
  u.rates = matrix<Rates>(of.attr("rates").cast<Array>(), "rates", 3);
  const auto moving = of.attr("moving").cast<Booleans>();
  u.moving.assign(moving.data(), moving.data() + moving.size());
  const py::object bond = of.attr("bond");
  if (!bond.is_none()) u.bond = matrix(bond.cast<Array>(), "bond");
  u.sheet = vector(of.attr("sheet").cast<Array>(), "sheet");
  u.gain = vector(of.attr("gain").cast<Array>(), "gain");
  u.offset = vector(of.attr("offset").cast<Array>(), "offset");
  u.resistance = vector(of.attr("resistance").cast<Array>(), "resistance");
  u.aside = matrix<Eigen::MatrixX2d>(of.attr("aside").cast<Array>(), "aside");
  return u;
}

py::dict dictionary(const Unknowns& u) {
  const Index k = u.contacts.cols();
  Booleans free({k, Index(6)}), moving(k);
  std::copy(u.free.data(), u.free.data() + u.free.size(), free.mutable_data());
  std::copy(u.moving.begin(), u.moving.end(), moving.mutable_data());
  const py::object bond = u.bond.size() ? py::object(array(u.bond)) : py::none();
  return py::dict("contacts"_a = array({k, 6}, u.contacts.data()), "across"_a = py::tuple(py::cast(u.across)),
                  "free"_a = free, "rates"_a = array({k, 3}, u.rates.data()), "moving"_a = moving, "bond"_a = bond,
                  "sheet"_a = array(u.sheet), "gain"_a = array(u.gain), "offset"_a = array(u.offset),
                  "resistance"_a = array(u.resistance), "aside"_a = array({2, u.aside.rows()}, u.aside.data()));
}

// What stands behind an object of Python: itself, or its attribute `core`.
template <class Held>
std::shared_ptr<Held> behind(const py::object& of) {
  if (py::isinstance<Held>(of)) return of.cast<std::shared_ptr<Held>>();
  return of.attr("core").cast<std::shared_ptr<Held>>();
}

Index contact_of(const Prediction& p, Index i) {
  const auto& t = p.middle().touches;
  if (!t || i < 0 || i >= t->count()) throw py::index_error("no such contact");
  return i;
}

// Derivatives of ln (force) of contact i by its parameters, by a contact law g = c p^exponent: force is pressure times
// area, and the area goes with the square of the radius.
Vector force_slope(const Prediction& p, Index i, double exponent) {
  const Snapshot& at = p.middle();
  const Touches& t = *at.touches;
  const auto changes = t.mean_change(contact_of(p, i), t.impedance_slope(i));
  Vector out = Vector::Zero(6);
  out[kStrength] = at.conductance[i].by_strength / exponent;
  for (int k = 0; k < 5; ++k) out[kMoving[k]] = at.conductance[i].by_mean * changes[k] / exponent;
  out[kRadius] += 2 * (1 - 1 / exponent);
  return out;
}

// Of ln 1 / (1/g + mean D), of what contact i and the way to it conduct: ln c, but for bare conductors.
Vector strength_slope(const Prediction& p, Index i) {
  const Snapshot& at = p.middle();
  const Touches& t = *at.touches;
  const double g = at.conductance[contact_of(p, i)].value;
  const auto changes = t.mean_change(i, t.impedance_slope(i));
  Vector out = Vector::Zero(6);
  out[kStrength] = at.conductance[i].by_strength / g;
  for (int k = 0; k < 5; ++k) out[kMoving[k]] = at.conductance[i].by_mean * changes[k] / g - changes[k];
  return out / (1 / g + t.mean[i]);
}

Vector of_contacts(const Prediction& p, const std::function<double(const Snapshot&, Index)>& value) {
  Vector out(p.middle().touches ? p.middle().touches->count() : 0);
  for (Index i = 0; i < out.size(); ++i) out[i] = value(p.middle(), i);
  return out;
}

Lattice lattice(const Array& start, const Array& step, const Integers& counts) {
  const Vector first = vector(start, "start"), apart = vector(step, "step");
  const std::vector<int> points = integers(counts, "counts");
  if (first.size() != 2 || apart.size() != 2 || points.size() != 2) refuse("lattice", "(2,) for start, step and counts");
  if (points[0] < 4 || points[1] < 4 || points[0] > 10000 || points[1] > 10000) refuse("counts", "from 4 to 10000");
  return {first, apart, Eigen::Vector2i(points[0], points[1])};
}

// What charges that are induced make of G among all places, P x P.
Matrix between(const InducedCharges& electrodes, const Points& places) {
  std::vector<int> all(places.cols());
  std::iota(all.begin(), all.end(), 0);
  Matrix out = Matrix::Zero(places.cols(), places.cols());
  Charges(electrodes, places).add_between(0, places.cols(), all, out);
  return out;
}

std::shared_ptr<Tables> tables(const py::dict& of) {
  const auto array_of = [&](const char* name) { return of[name].cast<Array>(); };
  auto t = std::make_shared<Tables>();
  t->outline.size = vector(array_of("size"), "size");
  t->outline.rectangle = of["rectangle"].cast<bool>();
  t->outline.circle = of["circle"].cast<double>();
  for (const py::handle& ring : of["rings"]) t->outline.rings.push_back(matrix<Points>(ring.cast<Array>(), "rings", 2));
  t->centres = matrix<Points>(array_of("centres"), "centres", 2);
  t->used = matrix<Points>(array_of("used"), "used", 2);
  t->position = integers(of["position"].cast<Integers>(), "position");
  t->radius = of["radius"].cast<double>();
  t->resistance = of["resistance"].cast<double>();
  t->pitch = of["pitch"].cast<double>();
  t->inverse = matrix(array_of("inverse"), "inverse").transpose();
  t->admittance = matrix(array_of("admittance"), "admittance").transpose();
  for (const py::handle& cut : of["discs"]) {
    const auto [points, area, radii] = cut.cast<std::tuple<Array, Array, Array>>();
    t->discs.push_back({matrix<Points>(points, "discs", 2), vector(area, "discs"), vector(radii, "discs")});
  }
  t->fine = of["fine"].cast<Lattice>();
  t->coarse = of["coarse"].cast<Lattice>();
  t->potentials = matrix(array_of("potentials"), "potentials");
  t->own = vector(array_of("own"), "own");
  t->smooth = matrix(array_of("smooth"), "smooth").transpose();
  t->induced = of["induced"].cast<InducedCharges>();
  t->fields = two(array_of("fields"), "fields");
  for (const py::handle& each : of["mirrors"]) {
    const auto [electrode, straight, turned, shift] =
        each.cast<std::tuple<int, std::complex<double>, std::complex<double>, std::complex<double>>>();
    t->mirrors.push_back({electrode, straight, turned, shift});
  }
  t->change = beside(matrices(array_of("change"), "change"));  // each of them symmetric
  const auto seen = of["seen"].cast<Booleans>();
  if (seen.ndim() != 2 || seen.shape(0) != seen.shape(1)) refuse("seen", "(n, n)");
  t->seen.resize(seen.shape(0), seen.shape(1));
  std::copy(seen.data(), seen.data() + seen.size(), t->seen.data());
  t->share_change = beside(matrices(array_of("share_change"), "share_change"), true);
  t->inside = vector(array_of("inside"), "inside");
  t->printed = of["printed"].cast<double>();
  t->cells = matrix<Points>(array_of("cells"), "cells", 2);
  t->reach = of["reach"].cast<double>();
  t->nodes = matrix(array_of("nodes"), "nodes").transpose();
  t->complete();
  return t;
}

Read read(const Booleans& valid) {  // of a row
  if (valid.ndim() != 1) refuse("valid", "of truth values of one dimension");
  return Read(valid.data(), valid.data() + valid.size());
}

Matrix mutual_of(const py::object& mutual) { return mutual.is_none() ? Matrix() : matrix(mutual.cast<Array>(), "mutual"); }

// A square array as it lies in memory.
Eigen::Map<const Matrix> square(const Array& a, const char* name) {
  if (a.ndim() != 2 || a.shape(0) != a.shape(1)) refuse(name, "(S, S)");
  return {a.data(), a.shape(0), a.shape(0)};
}

std::shared_ptr<RowModel> row_model(const py::object& operator_, const py::object& known, const Array& alone, const Array& aside,
                                    const Array& unsure, const Array& impedance, const Array& fields, const Array& wide) {
  const auto of = [&](const char* name) { return vector(known.attr(name).cast<Array>(), name); };
  Sensor sensor{of("sheet"), of("gain"), of("offset"), of("resistance"),
                vector(py::sequence(known.attr("deviations"))[2].cast<Array>(), "deviations"),
                matrix<Eigen::MatrixX2d>(aside, "aside"), matrix<Eigen::MatrixX2d>(unsure, "unsure"), vector(alone, "variance"),
                of("shift_deviation")};
  return std::make_shared<RowModel>(behind<Sheet>(operator_), std::move(sensor), matrix(impedance, "impedance"), two(fields, "fields"),
                                    matrix<Discs>(wide, "wide", 4));
}

// Numbers that stay where they are: read, not written, as long as somebody holds them.
Array view(const Matrix& m, const py::handle& held) {
  Array out({m.cols(), m.rows()}, m.data(), held);
  out.attr("setflags")("write"_a = false);
  return out;
}

std::shared_ptr<Belief> replaced(const Belief& b, const py::object& mean, const py::object& covariance, const py::object& sizes) {
  auto out = std::make_shared<Belief>(b);
  if (!mean.is_none()) out->mean = vector(mean.cast<Array>(), "mean");
  if (!covariance.is_none()) out->covariance = square(covariance.cast<Array>(), "covariance");
  if (!sizes.is_none()) out->sizes = matrix<Points>(sizes.cast<Array>(), "sizes", 2);
  out->check();
  return out;
}

// Takes a row into a state, which stays as it was where that fails.
template <class Take>
void taken(RowState& state, Take take) {
  RowState after = state;
  {
    Free free;
    after = take(std::move(after));
  }
  state = std::move(after);
}

py::object solution(const Solution& found) {
  return py::make_tuple(found.fit, found.equations, found.equations ? py::object(array(found.covariance)) : py::none(), found.steps,
                        found.work);
}

}  // namespace

PYBIND11_MODULE(TOMOTACTILE_MODULE, m) {
  m.doc() = "Forward model, fits and covariance of contacts on a resistive sheet, compiled.";
  py::register_exception_translator([](std::exception_ptr thrown) {
    try {
      if (thrown) std::rethrow_exception(thrown);
    } catch (const BadInput& error) {
      PyErr_SetString(PyExc_ValueError, error.what());
    } catch (const py::cast_error& error) {
      PyErr_SetString(PyExc_TypeError, error.what());
    } catch (const std::domain_error& error) {
      PyErr_SetString(py::module_::import("numpy.linalg").attr("LinAlgError").ptr(), error.what());
    }
  });

  py::class_<Lattice>(m, "Lattice").def(py::init(&lattice), "start"_a, "step"_a, "counts"_a);

  py::class_<InducedCharges>(m, "InducedCharges")
      .def(py::init([](const Array& centres, double radius, double resistance, const Array& size) {
             const Vector mirrored = vector(size, "size");
             if (mirrored.size() != 2) refuse("size", "(2,)");
             return InducedCharges(matrix<Points>(centres, "centres", 2), radius, resistance, mirrored);
           }), "centres"_a, "radius"_a, "resistance"_a, "size"_a)
      .def_property_readonly("counted", [](const InducedCharges& e) { return array(e.counted); })
      .def("between", [](const InducedCharges& e, const Array& places) { return between(e, matrix<Points>(places, "places", 2)); }, "places"_a)
      .def("own", [](const InducedCharges& e, const Array& places) { return array(e.own(matrix<Points>(places, "places", 2))); }, "places"_a)
      .def("potentials", [](const InducedCharges& e, const Array& places) -> Matrix {
             return e.dipoles(matrix<Points>(places, "places", 2)).transpose() * e.fed(e.centres);
           }, "places"_a);

  py::class_<Tables, std::shared_ptr<Tables>>(m, "Tables").def(py::init(&tables), "content"_a);

  py::class_<Sheet, std::shared_ptr<Sheet>>(m, "Sheet")
      .def(py::init([](std::shared_ptr<Tables> t, const Array& untouched) {
             return std::make_shared<Sheet>(t, matrix(untouched, "untouched").transpose());
           }), "tables"_a, "untouched"_a)
      .def(py::init([](std::shared_ptr<Tables> t, const Array& untouched, const Array& mean, const Array& factor, const Array& term,
                       const Array& share, const Array& own) {
             return std::make_shared<Sheet>(t, matrix(untouched, "untouched").transpose(), vector(mean, "mean"),
                                            Rest{matrix(factor, "factor").transpose(), matrix(term, "term").transpose(),
                                                 matrix(share, "share"), vector(own, "own")});
           }), "tables"_a, "untouched"_a, "mean"_a, "factor"_a, "term"_a, "share"_a, "own"_a)
      .def("discs", [](const Sheet& sheet, const Array& places, double radius) {
        Matrix share;
        std::array<Matrix, 2> slopes;
        sheet.discs_at(matrix<Points>(places, "places", 2), radius, share, slopes);
        return py::make_tuple(share, py::make_tuple(slopes[0], slopes[1]));
      }, "places"_a, "radius"_a);

  py::class_<Touches, std::shared_ptr<Touches>>(m, "Touches")
      .def(py::init([](const py::object& operator_, const Array& contacts, std::vector<int> across, const Array& coefficients) {
             return std::make_shared<Touches>(behind<Sheet>(operator_), matrix<Parameters>(contacts, "contacts", 6), std::move(across),
                                              vector(coefficients, "sheet"));
           }), "operator"_a, "contacts"_a, "across"_a, "sheet"_a)
      .def_property_readonly("contacts", [](const Touches& t) { return array({t.count(), 6}, t.contacts.data()); })
      .def_property_readonly("share", [](const Touches& t) { return t.share; })
      .def_property_readonly("impedance", [](const Touches& t) { return t.impedance; })
      .def_property_readonly("weight", [](const Touches& t) { return array(t.weight); })
      .def_property_readonly("direct", [](const Touches& t) { return array(t.direct); })
      .def_property_readonly("covered", [](const Touches& t) { return array(t.covered); })
      .def_property_readonly("mean", [](const Touches& t) { return array(t.mean); })
      .def_property_readonly("places", [](const Touches& t) { return array(t.places()); })
      .def_property_readonly("radii", [](const Touches& t) { return array(t.radii()); })
      .def_property_readonly("parts", [](const Touches& t) {
        py::list out;
        for (Index i = 0; i < t.count(); ++i) out.append(py::slice(t.begin(i), t.begin(i) + t.size(i), 1));
        return out;
      })
      .def_property_readonly("owner", [](const Touches& t) {
        Integers out(t.patches());
        for (Index i = 0; i < t.count(); ++i) std::fill_n(out.mutable_data() + t.begin(i), t.size(i), int(i));
        return out;
      })
      .def("stronger", [](const Touches& t, const Array& contacts) {
        const Parameters others = matrix<Parameters>(contacts, "contacts", 6);
        return std::const_pointer_cast<Touches>(t.with(t.coefficients, others, t.across, 0));
      })
      .def("centre", [](const Touches& t, Index i) {
        if (i < 0 || i >= t.count()) throw py::index_error("no such contact");
        return array(Vector(t.centre(i)));
      });
  m.def("conductance", [](double strength, double mean) {
    const Conductance found(strength, mean);
    return py::make_tuple(found.value, found.by_strength, found.by_mean);
  }, "strength"_a, "mean"_a, "g of a contact, S, by ln c and its mean D, ohm; derivatives of ln g by both.");
  m.def("stretch", [](const Array& contact) {
    if (contact.ndim() != 1 || contact.size() != 6) refuse("contact", "(6,)");
    return Matrix(stretch(vector(contact, "contact")));
  }, "contact"_a, "(2, 2) shape of a contact as a map of the unit disc, m.");

  py::class_<Prediction, std::shared_ptr<Prediction>>(m, "Prediction")
      .def(py::init([](const py::object& operator_, const py::object& u, const Integers& rows, std::shared_ptr<Touches> touches,
                       const py::object& times) {
             const Unknowns at = unknowns(u);
             const Vector when = times.is_none() ? Vector() : vector(times.cast<Array>(), "times");
             const std::vector<int> grounded = integers(rows, "rows");
             const std::shared_ptr<Sheet> sheet = behind<Sheet>(operator_);
             Free free;
             return std::make_shared<Prediction>(sheet, at, grounded, when, touches);
           }), "operator"_a, "unknowns"_a, "rows"_a, "touches"_a = py::none(), "times"_a = py::none())
      .def_property_readonly("readings", [](const Prediction& p) { return array(p.readings); })
      .def_property_readonly("ratio", [](const Prediction& p) { return array(p.ratio); })
      .def_property_readonly("own", [](const Prediction& p) { return array(p.own); })
      .def_property_readonly("rows", [](const Prediction& p) { return Integers(p.rows.size(), p.rows.data()); })
      .def_property_readonly("impedance", [](const Prediction& p) { return p.middle().impedance; })
      .def_property_readonly("added", [](const Prediction& p) { return p.middle().added(); })
      .def_property_readonly("fields", [](const Prediction& p) {
        const std::array<Matrix, 2> found = p.middle().fields();
        const Index n = found[0].rows();
        Array out({Index(2), n, n});
        for (Index d = 0; d < 2; ++d) Eigen::Map<Matrix>(out.mutable_data() + d * n * n, n, n) = found[d].transpose();
        return out;
      })
      .def_property_readonly("touches", [](const Prediction& p) { return std::const_pointer_cast<Touches>(p.middle().touches); })
      .def_property_readonly("size", &Prediction::work, "Number of patches in all evaluations, what the cost goes with.")
      .def_property_readonly("means", [](const Prediction& p) { return array(of_contacts(p, [](const Snapshot& at, Index i) { return at.touches->mean[i]; })); })
      .def_property_readonly("covered", [](const Prediction& p) { return array(of_contacts(p, [](const Snapshot& at, Index i) { return at.touches->covered[i]; })); })
      .def_property_readonly("conductances", [](const Prediction& p) { return array(of_contacts(p, [](const Snapshot& at, Index i) { return at.conductance[i].value; })); })
      .def_property_readonly("answering", [](const Prediction& p) { return array(answering(p)); })
      .def("force_slope", [](const Prediction& p, Index i, double exponent) { return array(force_slope(p, i, exponent)); })
      .def("strength_slope", [](const Prediction& p, Index i) { return array(strength_slope(p, i)); })
      .def("force_by_strength", [](const Prediction& p, double exponent) {
        return array(of_contacts(p, [exponent](const Snapshot& at, Index i) { return at.conductance[i].by_strength / exponent; }));
      })
      .def("force_by_impedance", [](const Prediction& p, Index i, double exponent) {
        const Snapshot& at = p.middle();
        return at.conductance[contact_of(p, i)].by_mean * at.touches->mean[i] / exponent;
      })
      .def("contact_columns", [](const Prediction& p) {
        Matrix out;
        { Free free; out = p.contact_columns(p.unknowns); }
        return columns(out, p.count());
      })
      .def("columns", [](const Prediction& p, const Booleans& wanted) {
        Matrix out;
        const Mask mask = free_of(wanted, p.unknowns.contacts.cols());
        { Free free; out = p.columns(mask); }
        return columns(out, p.count());
      })
      .def("sheet_columns", [](const Prediction& p) {
        Matrix out;
        { Free free; out = p.sheet_columns(); }
        return columns(out, p.count());
      })
      .def_property_readonly("aside", [](const Prediction& p) {
        Matrix read, ground;
        p.aside(read, ground);
        return py::make_tuple(columns(read, p.count()), columns(ground, p.count()));
      }, "(2, L, n) each: derivatives, without gains, by how far aside the electrode that is read lies, and the grounded one, 1/m.")
      .def("way_columns", [](const Prediction& p) { return columns(p.way_columns(), p.count()); })
      .def("pressure_columns", [](const Prediction& p, const std::vector<Array>& modes) {
        std::vector<Matrix> each;
        for (const Array& mode : modes) each.push_back(matrix(mode, "modes").eval());
        return columns(p.pressure_columns(each), p.count());
      });

  py::class_<Rows, std::shared_ptr<Rows>>(m, "Rows")
      .def(py::init([](const Array& readings, const Array& weights, const Integers& grounded, const py::object& times) {
             return std::make_shared<Rows>(matrix(readings, "readings"), matrix(weights, "weights"), integers(grounded, "grounded"),
                                           times.is_none() ? Vector() : vector(times.cast<Array>(), "times"));
           }), "readings"_a, "weights"_a, "grounded"_a, "times"_a = py::none());

  const auto seen = [](const Seen& s) { return py::make_tuple(array(s.places), array(s.strengths), s.left); };
  py::class_<FirstLook>(m, "FirstLook")
      .def(py::init([](const py::object& operator_, const Array& admittance, std::shared_ptr<Rows> rows, const Array& gain,
                       const Array& offset, const Array& pixels, const Array& share, double side) {
             return std::make_unique<FirstLook>(behind<Sheet>(operator_), matrix(admittance, "admittance"), *rows, vector(gain, "gain"),
                                                vector(offset, "offset"), matrix<Points>(pixels, "pixels", 2),
                                                matrix(share, "share").transpose(), side);
           }), "operator"_a, "admittance"_a, "rows"_a, "gain"_a, "offset"_a, "pixels"_a, "share"_a, "side"_a)
      .def_property_readonly("total", &FirstLook::total)
      .def("points", [seen](const FirstLook& look, double radius) {
        Seen found;
        { Free free; found = look.points(radius); }
        return seen(found);
      })
      .def("contacts", [seen](const FirstLook& look) {
        Seen found;
        { Free free; found = look.contacts(); }
        return seen(found);
      })
      .def("image", [](const FirstLook& look, const Array& share) {
        const Matrix of = matrix(share, "share").transpose();
        Free free;
        return look.image(of);
      });
  m.def("non_negative", [](const Array& normal, const Array& along) {
    const Matrix system = matrix(normal, "normal");
    const Vector right = vector(along, "along");
    Free free;
    return non_negative(system, right);
  }, "normal"_a, "along"_a, "x >= 0 with the least x normal x / 2 - along x.");

  py::class_<Prior, std::shared_ptr<Prior>>(m, "Prior")
      .def(py::init([](double radius, double spread, double stretch, const Array& rates, const Array& mean, const Array& deviation,
                       const py::object& precision, Index modes) {
             if (rates.ndim() != 1 || rates.size() != 3) refuse("rates", "(3,)");
             return std::make_shared<Prior>(radius, spread, stretch, Eigen::Vector3d(vector(rates, "rates")), vector(mean, "mean"),
                                            vector(deviation, "deviation"),
                                            precision.is_none() ? Matrix() : matrix(precision.cast<Array>(), "precision"), modes);
           }), "radius"_a, "spread"_a, "stretch"_a, "rates"_a, "mean"_a, "deviation"_a, "precision"_a, "modes"_a);

  py::class_<Slopes>(m, "Slopes")
      .def_property_readonly("kinds", &Slopes::kinds)
      .def_property_readonly("in_columns", [](const Slopes& s) { return columns(s.in_columns(), s.count()); })
      .def_property_readonly("in_rows", [](const Slopes& s) { return columns(s.in_rows(), s.count()); })
      .def("beside", [](const Slopes& s, const Array& more) { return s.beside(Eigen::Map<const Vector>(more.data(), more.size())); })
      .def("couplings", [](const Slopes& s, const Array& weighted) {
        if (weighted.ndim() != 3) refuse("weighted", "(P, L, n)");
        const Matrix flat = Eigen::Map<const Matrix>(weighted.data(), weighted.shape(1) * weighted.shape(2), weighted.shape(0));
        return Matrix(s.couplings(flat));
      })
      .def("normal", [](const Slopes& s, const Array& weights) { return s.normal(matrix(weights, "weights")); });

  py::class_<Equations, std::shared_ptr<Equations>>(m, "Equations")
      .def_property_readonly("normal", [](const Equations& e) { return e.normal; })
      .def_property_readonly("inverse", [](const Equations& e) { return e.inverse(); })
      .def_property_readonly("prediction", [](const Equations& e) { return std::const_pointer_cast<Prediction>(e.fit->prediction); })
      .def_property_readonly("by_ways", [](const Equations& e) { Free free; return e.by_ways(); })
      .def("response", [](const Equations& e, const Array& misfits) {
        if (misfits.ndim() != 3 || misfits.shape(1) * misfits.shape(2) != e.fit->misfit.size()) refuse("misfits", "(m, L, n)");
        const Matrix flat = Eigen::Map<const Matrix>(misfits.data(), e.fit->misfit.size(), misfits.shape(0));
        return e.response(flat);
      })
      .def("score", [](const Equations& e, const py::object& of, const Booleans& free) {
        const Fit& fit = *behind<Fit>(of);
        return e.score(fit, free_of(free, fit.unknowns.contacts.cols()));
      })
      .def("serves", [](const Equations& e, const py::object& fit) { return e.serves(*behind<Fit>(fit)); })
      .def("unevenness", [](const Equations& e, const py::object& fit) { return e.unevenness(*behind<Fit>(fit)); })
      .def_property_readonly("sheet_columns", [](const Equations& e) { return columns(e.sheet->flat, e.fit->misfit.rows()); });

  py::class_<Fit, std::shared_ptr<Fit>>(m, "Fit")
      .def(py::init([](std::shared_ptr<Sheet> sheet, const py::object& u, std::shared_ptr<Rows> rows, std::shared_ptr<Prior> prior,
                       std::shared_ptr<Prediction> prediction) {
             Unknowns at = unknowns(u);
             Free free;
             return std::make_shared<Fit>(sheet, std::move(at), rows, prior, prediction);
           }), "sheet"_a, "unknowns"_a, "rows"_a, "prior"_a, "prediction"_a = py::none())
      .def_property_readonly("unknowns", [](const Fit& f) { return dictionary(f.unknowns); })
      .def_property_readonly("prediction", [](const Fit& f) { return std::const_pointer_cast<Prediction>(f.prediction); })
      .def_property_readonly("misfit", [](const Fit& f) { return array(f.misfit); })
      .def_readonly("chi_squared", &Fit::chi_squared)
      .def_readonly("cost", &Fit::cost)
      .def_property_readonly("doubt", &Fit::doubt)
      .def_property_readonly("of_sensor", &Fit::of_sensor)
      .def_property_readonly("slopes", &Fit::slopes)
      .def("weighed", [](const Fit& f, std::shared_ptr<Rows> rows) { return std::make_shared<Fit>(f.weighed(rows)); })
      .def("at", [](const Fit& f, const py::object& u) {
        Unknowns at = unknowns(u);
        Free free;
        return std::make_shared<Fit>(f.with(std::move(at)));
      })
      .def_property_readonly("contact_priors", [](const Fit& f) {
        Matrix curvature;
        Vector pull;
        contact_priors(f, curvature, pull);
        return py::make_tuple(curvature, array(pull));
      });

  py::class_<Linear>(m, "Linear")
      .def_static("of_contacts", [](std::shared_ptr<Fit> fit) { Free free; return Linear::of_contacts(fit); }, "fit"_a)
      .def_static("of_all", [](std::shared_ptr<Fit> fit, std::shared_ptr<Equations> known, std::optional<bool> anew) {
        Free free;
        return Linear::of_all(fit, known, !anew ? Taken::kServing : *anew ? Taken::kSheet : Taken::kAll);
      }, "fit"_a, "known"_a = py::none(), "anew"_a = py::none())
      .def_readonly("free", &Linear::free)
      .def_readonly("beside", &Linear::beside)
      .def_property_readonly("normal", [](const Linear& l) { return l.normal; })
      .def_property_readonly("right", [](const Linear& l) { return array(l.right); })
      .def_property_readonly("alone", [](const Linear& l) { return array(l.alone); })
      .def_property_readonly("equations", [](const Linear& l) { return std::const_pointer_cast<Equations>(l.equations); })
      .def_property_readonly("promise", &Linear::promise)
      .def("covariance", &Linear::covariance)
      .def("step", [](const Linear& l, double damping) {
        const Step step = l.step(damping);
        return py::make_tuple(dictionary(step.unknowns), step.promised, step.whole);
      })
      .def("after", [](const Linear& l, const Array& step) {
        if (step.ndim() != 1 || step.size() != l.right.size()) refuse("step", "of all parameters");
        Vector way = vector(step, "step");
        const double longer = l.excess(way);
        way /= longer;
        return py::make_tuple(dictionary(l.after(way)), longer);
      });

  m.def("approach", [](std::shared_ptr<Fit> fit, double most) {
    Solution found;
    { Free free; found = approach(fit, most); }
    return solution(found);
  }, "fit"_a, "most"_a);
  m.def("solve", [](std::shared_ptr<Fit> fit, int steps, std::shared_ptr<Equations> known, double goal, double most) {
    Solution found;
    { Free free; found = solve(fit, steps, known, goal, most); }
    return solution(found);
  }, "fit"_a, "steps"_a, "known"_a, "goal"_a, "most"_a);

  py::class_<Row>(m, "Row")
      .def_property_readonly("readings", [](const Row& r) { return array(r.readings); })
      .def_property_readonly("changes", [](const Row& r) { return array(r.changes); });
  py::class_<RowModel, std::shared_ptr<RowModel>>(m, "RowModel")
      .def(py::init(&row_model), "operator"_a, "known"_a, "alone"_a, "aside"_a, "unsure"_a, "impedance"_a, "fields"_a, "wide"_a)
      .def("shares", [](const RowModel& model, const Array& contacts) {
        Matrix share;
        std::array<Matrix, 2> slopes;
        model.shares(matrix<Discs>(contacts, "contacts", 4), share, slopes);
        return py::make_tuple(array(share), py::make_tuple(array(slopes[0]), array(slopes[1])));
      }, "contacts"_a)
      .def("mutual", [](const RowModel& model, const Array& contacts) {
        const Matrix found = model.mutual(matrix<Discs>(contacts, "contacts", 4));
        return found.size() ? py::object(array(found)) : py::none();
      }, "contacts"_a)
      .def("row", [](const RowModel& model, const Array& contacts, Index ground, const Array& shift, const py::object& mutual,
                     const py::object& valid) {
        const Read all(model.count(), true);
        return model.row(matrix<Discs>(contacts, "contacts", 4), ground, vector(shift, "shift"), mutual_of(mutual),
                         valid.is_none() ? all : read(valid.cast<Booleans>()));
      }, "contacts"_a, "ground"_a, "shift"_a, "mutual"_a = py::none(), "valid"_a = py::none());

  py::class_<Belief, std::shared_ptr<Belief>>(m, "Belief")
      .def_static("untouched", [](const Array& deviation) { return Belief::untouched(vector(deviation, "deviation")); }, "deviation"_a)
      .def_property_readonly("count", &Belief::count)
      .def_property_readonly("mean", [](const Belief& b) { return array(b.mean); })
      .def_property_readonly("shift", [](const Belief& b) { return array(Vector(b.mean.tail(b.mean.size() - kState * b.count()))); })
      .def_property_readonly("covariance", [](const py::object& b) { return view(b.cast<const Belief&>().covariance, b); })
      .def_property_readonly("sizes", [](const Belief& b) { return array({b.count(), 2}, b.sizes.data()); })
      .def_property_readonly("numbers", [](const Belief& b) { return py::tuple(py::cast(b.numbers)); })
      .def_property_readonly("begun", [](const Belief& b) { return py::tuple(py::cast(b.begun)); })
      .def_property_readonly("rows", [](const Belief& b) { return py::tuple(py::cast(b.rows)); })
      .def_property_readonly("contacts", [](const Belief& b) { return array({b.count(), 4}, b.contacts().data()); })
      .def_property_readonly("places", [](const Belief& b) {
        py::dict out;
        for (Index i = 0; i < b.count(); ++i) {  // m, and m/s, and the covariance of these
          Eigen::Matrix4Xd each(4, 5);
          each << b.mean.segment<4>(kState * i), b.covariance.block<4, 4>(kState * i, kState * i);
          out[py::int_(b.numbers[i])] = array({5, 4}, each.data());
        }
        return out;
      })
      .def("without", [](const Belief& b, Index which) {
        if (which < 0 || which >= b.count()) throw py::index_error("no such contact");
        return b.without(which);
      }, "which"_a)
      .def("with_contact", [](const Belief& b, const Array& mean, const Array& covariance, const Array& size, int number, double begun, int rows) {
        if (mean.ndim() != 1 || mean.size() != kState || size.ndim() != 1 || size.size() != 2 || square(covariance, "covariance").rows() != kState)
          refuse("mean, covariance, size", "(5,), (5, 5), (2,)");
        return b.with_contact(vector(mean, "mean"), square(covariance, "covariance"), vector(size, "size"), number, begun, rows);
      }, "mean"_a, "covariance"_a, "size"_a, "number"_a, "begun"_a, "rows"_a = 0)
      .def("unlearned", [](const Belief& b, const Array& deviation) { return b.unlearned(vector(deviation, "deviation")); }, "deviation"_a)
      .def("replaced", &replaced, "mean"_a = py::none(), "covariance"_a = py::none(), "sizes"_a = py::none());

  py::class_<RowState>(m, "RowState")
      .def(py::init([](std::shared_ptr<Belief> belief) {
        RowState state;
        state.belief = std::move(belief);
        return state;
      }), "belief"_a)
      .def_property("belief", [](const RowState& s) { return std::const_pointer_cast<Belief>(s.belief); },
                    [](RowState& s, std::shared_ptr<Belief> belief) { s.belief = std::move(belief); })
      .def("take_model", [](RowState& s, const py::object& model) {
        s.model = behind<RowModel>(model), s.sums.resize(0, 0);
        s.distrusted.resize(s.model->count(), 0);
      }, "model"_a)
      .def_property("distrusted", [](const RowState& s) { return Integers(s.distrusted.size(), s.distrusted.data()); },
                    [](RowState& s, const Integers& rows) { s.distrusted = integers(rows, "distrusted"); })
      .def_readwrite("time", &RowState::time)
      .def_readwrite("last", &RowState::last)
      .def_readwrite("unexplained", &RowState::unexplained)
      .def_readwrite("confused", &RowState::confused)
      .def_readwrite("read", &RowState::read)
      .def_readwrite("touched_at_once", &RowState::touched_at_once)
      .def_readonly("untouched", &RowState::untouched)
      .def_readonly("misfit", &RowState::misfit);

  py::class_<Follower>(m, "Follower")
      .def(py::init([](const py::object& sheet, const Array& places, double threshold, double radius, double spread, double rate,
                       const Array& limits) {
        return Follower(behind<Sheet>(sheet), matrix<Points>(places, "places", 2), threshold, radius, spread, rate, matrix(limits, "limits", 3));
      }), "sheet"_a, "places"_a, "threshold"_a, "radius"_a, "spread"_a, "rate"_a, "limits"_a)
      .def("follow", [](const Follower& f, RowState& state, const Array& readings, const Booleans& valid, Index ground, double time) {
        const Vector row = vector(readings, "readings");
        taken(state, [&, which = read(valid)](RowState before) { return f.follow(std::move(before), row, which, ground, time); });
      }, "state"_a, "readings"_a, "valid"_a, "ground"_a, "time"_a)
      .def("wait", [](const Follower& f, RowState& state, const Array& readings, const Booleans& valid, double time) {
        const Vector row = vector(readings, "readings");
        taken(state, [&, which = read(valid)](RowState before) { return f.wait(std::move(before), row, which, time); });
      }, "state"_a, "readings"_a, "valid"_a, "time"_a);
  m.def("outliers", [](const Array& misfit, const Array& root, const Booleans& valid, int most) {
    const Outliers out = outliers(vector(misfit, "misfit"), square(root, "root").transpose(), read(valid), most);
    return py::make_tuple(out.found, out.gained);
  }, "misfit"_a, "root"_a, "valid"_a, "most"_a);
  m.attr("STATE") = kState;
  m.attr("YOUNG") = kYoung;
  m.attr("ENDURING") = kEnduring;
  m.attr("WITHIN") = kWithin;
  m.attr("WRONG") = kWrong;
  m.attr("REACH") = kReach;
  m.attr("REACH_STRENGTH") = kReachStrength;
  m.attr("SIMILAR") = kSimilar;
  m.attr("FIRST_DAMPING") = kFirstDamping;
  m.attr("STEPS") = kSteps;
  m.attr("FEW") = kFew;
  m.def("similar", [](const Array& contacts, const Array& others, double pitch, double within) {
    return similar(matrix<Parameters>(contacts, "contacts", 6), matrix<Parameters>(others, "others", 6), pitch, within);
  }, "contacts"_a, "others"_a, "pitch"_a, "within"_a);
}
