//! Where the data of a long record stop.

use super::record::Kept;
use crate::data::run::Run;
use crate::data::zero_field::DataStop;

/// Gaps as long as this are stops, s.
const STOP_S: f64 = 10.0;
/// Samples that are all alike for this long, and at least so many, are no measurement.
const FROZEN_S: f64 = 10.0;
const FROZEN_SAMPLES: u64 = 64;

/// Where the data begin late, end early, have long gaps, or stand still.
pub(super) fn stops(run: &Run, record: &Kept, span_s: [f64; 2], rate_hz: f64) -> Vec<DataStop> {
    let mut list = Vec::new();
    let least_s = (2.0 / rate_hz).max(1.0);
    if let (Some(first), Some(last)) = (run.settings.first(), run.settings.last()) {
        if span_s[0] > first.t_start_s + least_s {
            list.push(DataStop {
                what: "the data begin after the setting does".to_owned(),
                from_s: first.t_start_s,
                until_s: span_s[0],
            });
        }
        if span_s[1] + least_s < last.t_end_s {
            list.push(DataStop {
                what: "the data end before the setting does".to_owned(),
                from_s: span_s[1],
                until_s: last.t_end_s,
            });
        }
    }
    for gap in &run.vectors.gaps {
        let length_s = gap.lost as f64 / rate_hz;
        if length_s >= STOP_S {
            list.push(DataStop { what: "samples are missing".to_owned(), from_s: gap.t_s - length_s, until_s: gap.t_s });
        }
    }
    if let Some([from_s, until_s]) = record.frozen_s
        && until_s - from_s >= FROZEN_S
        && (until_s - from_s) * rate_hz >= FROZEN_SAMPLES as f64
    {
        list.push(DataStop { what: "all three readings stand still".to_owned(), from_s, until_s });
    }
    list.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    list
}
