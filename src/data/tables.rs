//! Rows of the small tables that analyses take in place of a run.

/// Amplitudes of a sine at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmplitudeRow {
    /// Frequency of the field, Hz.
    pub frequency_hz: f64,
    /// Amplitude per component, half peak to peak, enT.
    pub amplitude_ent: [f64; 3],
    /// Its standard uncertainty, enT; nan where the table does not tell.
    pub std_ent: [f64; 3],
}

/// Moduli of the field at plus and minus F on one coil axis.
#[derive(Clone, Debug, PartialEq)]
pub struct ModulusRow {
    /// Coil axis, 0 to 2.
    pub axis: usize,
    /// State of the facility.
    pub state: String,
    /// Modulus at plus F, nT.
    pub plus_nt: f64,
    /// Modulus at minus F, nT.
    pub minus_nt: f64,
    /// Standard uncertainty of a modulus, nT, if the table tells.
    pub std_nt: Option<f64>,
}

/// Reading of a thermistor at one temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermistorRow {
    /// Temperature, °C.
    pub t_degc: f64,
    /// Voltage, V; NaN if the table has none.
    pub u_volt: f64,
    /// Resistance, Ω; NaN if the table has none.
    pub r_ohm: f64,
}
