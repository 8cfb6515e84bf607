//! The table of amplitudes, and which of its rows count.

/// An amplitude of fewer standard deviations is not detected.
const DETECTED: f64 = 3.0;

/// One row of the table of amplitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Amplitude {
    /// Frequency of the field, Hz.
    pub frequency_hz: f64,
    /// Amplitudes, enT; a component without one has NaN.
    pub amplitude_ent: [f64; 3],
    /// Their standard deviations, enT; NaN where unknown.
    pub std_ent: [f64; 3],
    /// Middle of the time in which the field was applied, s since the start of the run; nan where that is not known.
    pub t_s: f64,
    /// Whether the row counts.
    pub usable: bool,
}

/// Usable rows of a component by ascending frequency.
pub(super) fn usable(table: &[Amplitude], component: usize, omitted: &[usize]) -> Vec<usize> {
    let counts = |(i, row): (usize, &Amplitude)| {
        let amplitude = row.amplitude_ent[component];
        let good =
            row.usable && amplitude.is_finite() && amplitude >= 0.0 && row.frequency_hz.is_finite() && row.frequency_hz >= 0.0;
        (good && omitted.binary_search(&i).is_err()).then_some(i)
    };
    let mut rows: Vec<usize> = table.iter().enumerate().filter_map(counts).collect();
    rows.sort_by(|&a, &b| table[a].frequency_hz.total_cmp(&table[b].frequency_hz));
    rows
}

/// Standard deviation of an amplitude, enT; 0 where it is not known.
pub(super) fn std_ent(row: &Amplitude, component: usize) -> f64 {
    let std = row.std_ent[component];
    if std.is_finite() && std > 0.0 { std } else { 0.0 }
}

/// Whether an amplitude stands out of its noise.
pub(super) fn detected(row: &Amplitude, component: usize) -> bool {
    let amplitude = row.amplitude_ent[component];
    amplitude > 0.0 && amplitude >= DETECTED * std_ent(row, component)
}
