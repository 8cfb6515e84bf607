//! How a component of the sensor saw the coil axes.

use super::stay::Stay;
use crate::data::offset::RefusedComponent;

/// How one component saw the coil axes.
pub(super) struct Sight {
    /// First visit of its normal position.
    pub normal: usize,
    /// First visits of the positions in which the component looks the other way.
    pub turned: Vec<usize>,
    /// The positions that are compared, the normal one first.
    pub positions: Vec<u32>,
    /// The coil axis along which it looks in the normal position.
    pub normal_axis: String,
    /// The axes it looked along, without repeats.
    axes: Vec<String>,
}

impl Sight {
    /// Of a component in all visits.
    pub fn of(stays: &[Stay], component: usize) -> Self {
        // The position with the lowest id is the normal one of a pair.
        let mut order: Vec<usize> = (0..stays.len()).collect();
        order.sort_by_key(|v| stays[*v].id);
        order.dedup_by_key(|v| stays[*v].id);
        let axis = |v: usize| stays[v].position.names()[component].clone();
        let flips = |a: usize, b: usize| axis(a)[1..] == axis(b)[1..] && axis(a) != axis(b);
        let normal = order.iter().copied().find(|v| order.iter().any(|w| flips(*v, *w))).unwrap_or(order[0]);
        let turned: Vec<usize> = order.iter().copied().filter(|w| flips(normal, *w)).collect();
        let compared: Vec<usize> = if turned.is_empty() {
            order.clone()
        } else {
            let same_axis = |v: &usize| axis(*v)[1..] == axis(normal)[1..] && *v != normal;
            std::iter::once(normal).chain(order.iter().copied().filter(same_axis)).collect()
        };
        let mut axes: Vec<String> = order.iter().map(|v| axis(*v)).collect();
        axes.sort();
        axes.dedup();
        Self { normal, turned, positions: compared.iter().map(|v| stays[*v].id).collect(), normal_axis: axis(normal), axes }
    }

    /// Why it has no offset, and what to do.
    pub fn refusal(&self, component: &str) -> RefusedComponent {
        RefusedComponent {
            component: component.to_owned(),
            reason: format!(
                "no position shows it turned: it looks along {} only, and residual field and offset are the same there",
                self.axes.join(" and ")
            ),
            remedy: format!("measure a position in which {component} looks the other way"),
        }
    }
}
