//! Where the quantities of a parameter file stand, for the exports that list them.

/// A part of a file by its JSON pointer: `/matrix/sigma`.
pub type Pointer = &'static str;

/// The quantities of a kind of parameter file.
pub struct Quantities {
    /// Polynomials of a temperature or a signal.
    pub polynomials: &'static [Polynomial],
    /// Numbers, vectors and matrices.
    pub entries: &'static [Entry],
    /// Lowest and highest temperature for which they hold, °C.
    pub valid_degc: Option<Validity>,
}

/// A quantity that is a number, a vector or a matrix.
#[derive(Clone, Copy)]
pub struct Entry {
    /// Name.
    pub name: &'static str,
    /// How the numbers lie in the file.
    pub shape: Shape,
    /// Where they stand.
    pub value: Pointer,
    /// Where their standard uncertainties stand; empty if there are none.
    pub std: Pointer,
    /// Unit.
    pub unit: &'static str,
    /// Frame, or what it belongs to.
    pub frame: &'static str,
}

impl Entry {
    /// An entry from its parts in the order of the fields.
    #[must_use]
    pub const fn of(
        name: &'static str,
        shape: Shape,
        value: Pointer,
        std: Pointer,
        unit: &'static str,
        frame: &'static str,
    ) -> Self {
        Self { name, shape, value, std, unit, frame }
    }
}

/// How the numbers of an entry lie in the file.
#[derive(Clone, Copy)]
pub enum Shape {
    /// One number; the component has this name.
    Scalar(&'static str),
    /// x, y, z.
    Vector,
    /// xy, xz, yz.
    Pairs,
    /// Three rows of three.
    Matrix,
    /// The diagonal of three rows of three; its uncertainties are x, y, z.
    Diagonal,
}

/// A polynomial, whose coefficients stand under a key of the file, lowest order first.
pub struct Polynomial {
    /// The key.
    pub key: &'static str,
    /// Name of a coefficient without its order.
    pub name: &'static str,
    /// Component.
    pub component: &'static str,
    /// Unit of the value.
    pub unit: &'static str,
    /// Frame, or what it belongs to.
    pub frame: &'static str,
    /// What it depends on, and where the uncertainties stand.
    pub of: Argument,
}

/// What a polynomial depends on.
#[derive(Clone, Copy)]
pub enum Argument {
    /// A temperature in °C; the covariance of the coefficients stands under `covariance` with the same key.
    Temperature,
    /// The signal of a thermistor in the unit of the key `signal_unit`, between the values of `valid_signal`; standard uncertainties stand
    /// beside the coefficients.
    Signal,
}

/// The sensor axes.
pub const SENSOR: &str = "sensor axes";
/// The coil axes.
pub const COIL: &str = "coil axes";
/// Angles between sensor axes.
pub const BETWEEN: &str = "between sensor axes";

/// Where a file tells for which temperatures its values hold.
#[derive(Clone, Copy)]
pub enum Validity {
    /// Between the temperatures that stand there, °C.
    Between([Pointer; 2]),
    /// About the mean temperature of a run, whose smallest, mean and largest sensor temperature stand there, °C.
    OfRun(Pointer),
}

/// Lowest and highest temperature under the key `valid_degc`.
pub const VALID_DEGC: Option<Validity> = Some(Validity::Between(["/valid_degc/0", "/valid_degc/1"]));
/// Lowest and highest sensor temperature of a run.
pub const RUN_DEGC: Option<Validity> = Some(Validity::Between(["/conditions/sensor_degc/0", "/conditions/sensor_degc/2"]));

const fn of_temperature(
    key: &'static str,
    name: &'static str,
    component: &'static str,
    unit: &'static str,
    frame: &'static str,
) -> Polynomial {
    Polynomial { key, name, component, unit, frame, of: Argument::Temperature }
}

/// Temperature polynomials of all kinds of files; a file has those that it has a key for.
pub const OF_TEMPERATURE: [Polynomial; 18] = [
    of_temperature("sigma_x", "sigma_T", "x", "nT/enT", SENSOR),
    of_temperature("sigma_y", "sigma_T", "y", "nT/enT", SENSOR),
    of_temperature("sigma_z", "sigma_T", "z", "nT/enT", SENSOR),
    of_temperature("xi_xy", "xi_T", "xy", "deg", BETWEEN),
    of_temperature("xi_xz", "xi_T", "xz", "deg", BETWEEN),
    of_temperature("xi_yz", "xi_T", "yz", "deg", BETWEEN),
    of_temperature("b_or_x", "b_or_T", "x", "enT", SENSOR),
    of_temperature("b_or_y", "b_or_T", "y", "enT", SENSOR),
    of_temperature("b_or_z", "b_or_T", "z", "enT", SENSOR),
    of_temperature("b_off_x", "b_off_T", "x", "enT", SENSOR),
    of_temperature("b_off_y", "b_off_T", "y", "enT", SENSOR),
    of_temperature("b_off_z", "b_off_T", "z", "enT", SENSOR),
    of_temperature("f_3db_x", "f_3db_T", "x", "Hz", SENSOR),
    of_temperature("f_3db_y", "f_3db_T", "y", "Hz", SENSOR),
    of_temperature("f_3db_z", "f_3db_T", "z", "Hz", SENSOR),
    of_temperature("f_3db_igep_x", "f_3db_igep_T", "x", "Hz", SENSOR),
    of_temperature("f_3db_igep_y", "f_3db_igep_T", "y", "Hz", SENSOR),
    of_temperature("f_3db_igep_z", "f_3db_igep_T", "z", "Hz", SENSOR),
];

/// Temperature polynomials and nothing else.
pub const POLYNOMIALS: Quantities = Quantities { polynomials: &OF_TEMPERATURE, entries: &[], valid_degc: VALID_DEGC };

/// The coefficients of the square that linearise a reading, r + c2 r^2 + c3 r^3, in files that hold for such readings.
pub const LINEARISATION_C2: Entry = Entry::of(
    "linearisation_c2",
    Shape::Vector,
    "/linearisation/applied/c2_per_ent",
    "/linearisation/applied/c2_std_per_ent",
    "1/enT",
    SENSOR,
);
/// Those of the cube.
pub const LINEARISATION_C3: Entry = Entry::of(
    "linearisation_c3",
    Shape::Vector,
    "/linearisation/applied/c3_per_ent2",
    "/linearisation/applied/c3_std_per_ent2",
    "1/enT^2",
    SENSOR,
);
