//! The response of the instrument, fitted to the amplitudes.

use crate::data::frequency::SineAmplitude;
use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::fit::statistics::median;
use crate::measure::corner::{self, Amplitude, AmplitudeDrift, Component, Corner, ModelCorner};

/// Weight in the response fit from which an amplitude counts as used.
const USED: f64 = 0.5;
/// Median of the modulus of a normal deviate.
const NORMAL_MEDIAN: f64 = 0.6745;
/// A response that leaves so many times the noise does not describe the amplitudes.
const MANY_TIMES: f64 = 3.0;

/// Fits the response to the amplitudes that can be compared with each other.
pub(super) fn respond(measured: &mut [SineAmplitude], compared: &[[bool; 3]], notes: &mut Vec<Note>) -> Corner {
    let table: Vec<Amplitude> = measured
        .iter()
        .zip(compared)
        .map(|(a, compared)| Amplitude {
            frequency_hz: a.frequency_hz,
            // What is not detected is no amplitude, and a fit of noise would find a corner in it.
            amplitude_ent: std::array::from_fn(|i| if a.detected[i] && compared[i] { a.b_ent[i] } else { f64::NAN }),
            std_ent: a.b_std_ent,
            t_s: a.used_s.map_or(f64::NAN, |[begin, end]| 0.5 * (begin + end)),
            usable: a.used && a.detected.contains(&true),
        })
        .collect();
    let corner = corner::corner(&table, &corner::Options::default());
    for (row, part) in measured.iter_mut().enumerate() {
        part.used &= part.detected.contains(&true);
        part.weight = std::array::from_fn(|i| {
            let fitted = corner.components[i].model.as_ref().and_then(|m| m.weight.get(row)).copied();
            fitted.unwrap_or(f64::from(u8::from(part.used && compared[row][i])))
        });
        let counts = |i: &usize| part.detected[*i] && compared[row][*i];
        let outlying: Vec<&str> =
            (0..3).filter(|i| part.used && counts(i) && part.weight[*i] < USED).map(|i| COMPONENTS[i]).collect();
        part.used = part.used && (0..3).all(|i| !counts(&i) || part.weight[i] >= USED);
        if !outlying.is_empty() {
            part.add_remark(&format!("{} does not follow the response and has little weight in it", outlying.join(", ")));
        }
        let silent: Vec<&str> =
            (0..3).filter(|i| part.b_ent[*i].is_finite() && !part.detected[*i]).map(|i| COMPONENTS[i]).collect();
        if !silent.is_empty() {
            part.add_remark(&format!("not detected in {}", silent.join(", ")));
        }
    }
    for (name, component) in COMPONENTS.into_iter().zip(&corner.components) {
        let reasons = [(&component.igep_refusal, "by interpolation"), (&component.model_refusal, "by a model")];
        for (refusal, how) in reasons {
            if let Some(refusal) = refusal {
                let text = format!("{name} has no -3 dB frequency {how}: {refusal}");
                notes.push(Note::new(NoteKind::Method, text).about(name));
            }
        }
    }
    notes.extend(COMPONENTS.into_iter().zip(&corner.components).filter_map(|(name, component)| interpolated(name, component)));
    notes.extend(unexplained(&table, &corner));
    notes.extend(corner.drift.as_ref().map(|drift| drifting(drift, &corner)));
    corner
}

/// Says of a -3 dB frequency by interpolation that it is far from that of the response: it rests on the two amplitudes beside it and on the largest one,
/// and a single wrong one moves it.
fn interpolated(name: &str, component: &Component) -> Option<Note> {
    /// Two neighbouring frequencies of a programme are hardly farther apart.
    const FAR: f64 = 1.3;
    let (igep_hz, model_hz) = (component.f_3db_igep_hz?, component.model.as_ref()?.f_3db_model_hz);
    (!(1.0 / FAR..=FAR).contains(&(igep_hz / model_hz))).then(|| {
        let text = format!(
            "the -3 dB frequency of {name} is {igep_hz:.2} Hz by interpolation between neighbouring amplitudes and {model_hz:.2} Hz by the response: an \
             amplitude on which the former rests is not that of the others"
        );
        Note::new(NoteKind::Fit, text).about(name).with_remedy("use that of the response, or leave the wrong setting out")
    })
}

/// Says of a drift of the amplitudes what it does.
fn drifting(drift: &AmplitudeDrift, corner: &Corner) -> Note {
    let change = COMPONENTS.iter().zip(drift.change).filter(|(_, change)| change.is_finite());
    let change: Vec<String> = change.map(|(name, change)| format!("{change:+.1e} in {name}")).collect();
    let change = change.join(", ");
    let text = if drift.is_found {
        format!(
            "the amplitudes change by {change} from the first to the last frequency beside what the response \"{}\" does, as of a source \
             or a gain that drifts; that describes them far better than any response alone, and the response holds beside it",
            drift.model
        )
    } else {
        format!(
            "amplitudes that change by {change} from the first to the last frequency beside the response \"{}\", as of a source or a gain \
             that drifts, are described as well as by \"{}\" alone: the frequencies follow each other in time; what it would change is in \
             the uncertainties of f_3dB and of the DC gain",
            drift.model,
            corner.model.unwrap_or("none")
        )
    };
    let remedy = "measure some of the first frequencies again at the end of the run";
    Note::new(NoteKind::Gain, text).with_remedy(remedy)
}

/// Says of amplitudes with known noise that none of the responses describes them within it.
fn unexplained(table: &[Amplitude], corner: &Corner) -> Option<Note> {
    let known = |row: &&Amplitude| row.usable && row.std_ent.iter().all(|std| *std > 0.0);
    let model = corner.model.filter(|_| corner.explained.is_none())?;
    let rows: Vec<usize> = (0..table.len()).filter(|i| known(&&table[*i])).collect();
    let of = |model: &ModelCorner, c: usize| {
        let mut sizes: Vec<f64> =
            rows.iter().map(|i| (model.residual_ent[*i] / table[*i].std_ent[c]).abs()).filter(|z| z.is_finite()).collect();
        if sizes.is_empty() { 0.0 } else { median(&mut sizes) / NORMAL_MEDIAN }
    };
    let worst = (0..3).filter_map(|c| Some((c, of(corner.components[c].model.as_ref()?, c)))).max_by(|a, b| a.1.total_cmp(&b.1));
    let (component, times) = worst.filter(|(_, times)| *times > MANY_TIMES)?;
    let text = format!(
        "the response \"{model}\", the best of those that are known, leaves {times:.0} times the noise of the amplitudes in {}; the \
         uncertainties follow what it leaves",
        COMPONENTS[component]
    );
    let remedy = "look for a change of the gain from one frequency to the next, or for a response of another kind";
    Some(Note::new(NoteKind::Fit, text).with_remedy(remedy))
}
