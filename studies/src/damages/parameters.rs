//! The parameters of a result with their standard uncertainties, of what `--json` prints.

use super::Kind;
use serde_json::Value;

/// Where values and standard uncertainties stand, per kind.
fn places(kind: Kind) -> &'static [(&'static str, &'static str)] {
    match kind {
        Kind::Linearity | Kind::Means | Kind::Moving | Kind::Imported => {
            &[("/matrix/phi", "/std/phi"), ("/offset/b_or_ent", "/std/b_or_ent"), ("/angle_deg/xi_xy", "/std/xi_deg/0")]
        }
        Kind::Offset => &[("/offset_ent", "/offset_std_ent"), ("/residual_coil_nt", "/residual_coil_std_nt")],
        Kind::Sines => &[
            ("/f_s_hz", "/f_s_std_hz"),
            ("/f_3db_model_hz", "/f_3db_model_std_hz"),
            ("/model/values/0/0", "/model/std/0/0"),
            ("/model/values/1/0", "/model/std/1/0"),
        ],
        Kind::Amplitudes => &[("/f_3db_model_hz", "/f_3db_model_std_hz"), ("/model/values/0/0", "/model/std/0/0")],
        Kind::ZeroField => &[
            ("/offset/mean_ent", "/offset/mean_std_ent"),
            ("/offset/drift_ent_per_h", "/offset/drift_std_ent_per_h"),
            ("/density/ent_per_root_hz", "/density/std_ent_per_root_hz"),
        ],
        Kind::Scalar => &[
            ("/facility/scale_nt_per_eu", "/std/scale_nt_per_eu"),
            ("/facility/offset_nt", "/std/offset_nt"),
            ("/facility/angles_deg", "/std/angles_deg"),
        ],
        Kind::Sweep | Kind::Applied => &[],
    }
}

/// Every parameter: name, value, standard uncertainty.
pub fn parameters(kind: Kind, result: &Value) -> Vec<(String, f64, f64)> {
    let mut list = Vec::new();
    for (value, std) in places(kind) {
        let [mut values, mut stds] = [Vec::new(), Vec::new()];
        numbers(result.pointer(value), &mut values);
        numbers(result.pointer(std), &mut stds);
        let name = value.rsplit('/').find(|part| part.parse::<u32>().is_err()).unwrap_or(value);
        list.extend(values.into_iter().zip(stds).enumerate().map(|(i, (v, s))| (format!("{name} {i} of {value}"), v, s)));
    }
    if kind == Kind::Sweep {
        for quantity in result.get("quantity").and_then(Value::as_array).into_iter().flatten() {
            let name = quantity.get("name").and_then(Value::as_str).unwrap_or_default();
            let [mut values, mut covariance] = [Vec::new(), Vec::new()];
            numbers(result.get(name), &mut values);
            numbers(result.pointer(&format!("/covariance/{name}")), &mut covariance);
            let n = values.len();
            // The value at zero degrees, which is within the range of the sweep.
            if let (Some(value), Some(variance)) = (values.first(), covariance.first().filter(|_| n > 0)) {
                list.push((name.to_owned(), *value, variance.sqrt()));
            }
        }
    }
    list
}

fn numbers(value: Option<&Value>, list: &mut Vec<f64>) {
    match value {
        Some(Value::Array(values)) => values.iter().for_each(|v| numbers(Some(v), list)),
        Some(Value::Number(number)) => list.extend(number.as_f64()),
        Some(Value::Null) => list.push(f64::NAN),
        _ => {}
    }
}
