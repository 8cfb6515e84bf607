//! The classes: what each heater adds to the field, and how long it uses to be off and on, from all intervals together.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::fit::statistics::central_median;

use super::background::Background;
use super::cells::Cells;
use super::courses::{self, Course};
use super::edges::{Edge, Evidence, Normal};
use super::states::{Dwell, Ends};
use super::{EDGES_S, HeaterClass, HeaterError, HeaterMethod, HeaterOptions, LEAST_TIMES, REACH_CELLS, ROUNDS, classes, screen};

/// Logarithm of the ratio of probabilities from which on a polarity is known.
const CLEAR: f64 = 10.0;
/// What an edge must gain in the logarithm of the likelihood, to compare first courses.
const EDGE_COST: f64 = 6.0;
/// Length of edges with which they are looked for first, s.
const FIRST_EDGE_S: f64 = 1.0;
/// Chance of a heater to switch in a cell before anything is known.
const FIRST_HAZARD: f64 = 0.05;
/// A class of so few edges is not believed where its field is far outside of what is usual: a disturbance that comes and goes once has as many.
const FEW_EDGES: usize = 2;

/// Class vectors, times in a state and the length of edges, from all intervals together; with the table, times are those of the table.
/// Without it nothing says which heater has which name: they are named in order of their strength, and those that were not seen come last.
///
/// # Errors
/// Options or a table that contradict themselves.
pub fn learn(records: &[Cells], options: &HeaterOptions) -> Result<Vec<HeaterClass>, HeaterError> {
    super::check(options)?;
    let increments: Vec<_> = records.par_iter().map(Cells::increments).collect();
    let classes = with_best_edges(records, &increments, options);
    let is_rare = |class: &&HeaterClass| (1..=FEW_EDGES).contains(&class.edges);
    let believed: Vec<Vector3<f64>> =
        classes.iter().filter(|class| !is_rare(class)).map(|class| class.vector_nt.into()).collect();
    let usual_nt = increments.iter().map(|increments| screen::strange_nt(increments, &believed)).fold(0.0, f64::max);
    let is_strange = |class: &HeaterClass| Vector3::from(class.vector_nt).norm() > usual_nt;
    if options.method != HeaterMethod::Found || !classes.iter().filter(is_rare).any(is_strange) {
        return Ok(classes);
    }
    let left: Vec<_> = increments.into_par_iter().map(|increments| screen::without_strange(increments, &believed)).collect();
    Ok(with_best_edges(records, &left, options))
}

/// Classes with edges of the length that is stated, or of the most probable one.
fn with_best_edges(records: &[Cells], increments: &[Vec<Vector3<f64>>], options: &HeaterOptions) -> Vec<HeaterClass> {
    let (found, classes) = with_edges(records, increments, &options.with_edges(options.edge_s.unwrap_or(FIRST_EDGE_S)));
    if options.edge_s.is_some() {
        return classes;
    }
    let of = |edge_s: f64| Learning { increments, options: &options.with_edges(edge_s) }.moved(&found, &classes);
    // Of lengths that say the same, the first one.
    let lengths = EDGES_S.map(|edge_s| (of(edge_s), edge_s)).into_iter();
    let best = lengths.reduce(|best, next| if next.0 > best.0 { next } else { best }).map_or(FIRST_EDGE_S, |(_, edge_s)| edge_s);
    if best == FIRST_EDGE_S { classes } else { with_edges(records, increments, &options.with_edges(best)).1 }
}

/// Courses and classes with edges of one length.
fn with_edges(records: &[Cells], increments: &[Vec<Vector3<f64>>], options: &HeaterOptions) -> (Vec<Course>, Vec<HeaterClass>) {
    let learning = Learning { increments, options };
    let heaters = options.classes.len();
    if let HeaterMethod::Table(table) = &options.method {
        let mut classes = super::unknown(options);
        let mut found = Vec::new();
        let edges: Vec<_> = records.iter().map(|cells| courses::of_table(table, cells, options)).collect();
        for _ in 0..ROUNDS {
            let vectors = super::vectors(&classes);
            found = increments
                .par_iter()
                .zip(&edges)
                .map(|(increments, edges)| courses::given(increments, edges, &vectors, options))
                .collect();
            classes = learning.summarise(&found);
        }
        return (found, classes);
    }
    let raw: Vec<Background> = increments.par_iter().map(|increments| Background::of(increments, options.order)).collect();
    let none = raw.into_iter().map(|background| Course { edges: Vec::new(), background }).collect::<Vec<_>>();
    // Two ways to begin: all vectors at once from all steps, or one after the other, each from the steps that those before leave.
    // What the whole course says decides; its ends are left open as long as polarities are.
    let together =
        learning.guess(&none, &vec![Vector3::zeros(); heaters], heaters).map(|vectors| learning.first(&none, &vectors));
    let mut one_by_one: Option<(f64, Vec<Course>, Vec<HeaterClass>)> = None;
    if heaters > 1 {
        for _ in 0..heaters {
            let (courses, vectors) =
                one_by_one.as_ref().map_or((&none, Vec::new()), |(_, courses, classes)| (courses, super::vectors(classes)));
            let Some(more) = learning.guess(courses, &vectors, 1) else { break };
            let known: Vec<_> = vectors.into_iter().filter(|vector| vector.norm() > 0.0).chain(more).collect();
            one_by_one = Some(learning.first(courses, &known));
        }
    }
    let begun = together.into_iter().chain(one_by_one).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some((_, mut found, mut classes)) = begun else { return (none, super::unknown(options)) };
    for round in 1..=ROUNDS {
        if round <= 2 {
            let even = learning.turn(&mut classes, &mut found);
            if round == 2 {
                even.into_iter().for_each(|heater| learning.decide(&mut classes, &mut found, heater));
            }
        }
        let ends = if round == 1 { Ends::Free } else { Ends::Off };
        (found, classes) = learning.next(&found, &classes, round == 2, ends);
    }
    let length = |heater: &usize| Vector3::from(classes[*heater].vector_nt).norm();
    let mut order: Vec<usize> = (0..classes.len()).collect();
    order.sort_by(|a, b| (classes[*a].edges == 0).cmp(&(classes[*b].edges == 0)).then(length(a).total_cmp(&length(b))));
    let named = |(heater, name): (&usize, &String)| HeaterClass { name: name.clone(), ..classes[*heater].clone() };
    let sorted = order.iter().zip(&options.classes).map(named).collect();
    let place = |heater: usize| order.iter().position(|old| *old == heater).unwrap_or(heater);
    found.iter_mut().flat_map(|course| &mut course.edges).for_each(|edge| edge.heater = place(edge.heater));
    (found, sorted)
}

/// Turns the vector of a heater, and what was off is on.
fn invert(classes: &mut [HeaterClass], courses: &mut [Course], heater: usize) {
    let class = &mut classes[heater];
    class.vector_nt = class.vector_nt.map(|component| -component);
    std::mem::swap(&mut class.off_s, &mut class.on_s);
    let edges = courses.iter_mut().flat_map(|course| &mut course.edges);
    edges.filter(|edge| edge.heater == heater).for_each(|edge| edge.on = !edge.on);
}

/// All intervals.
struct Learning<'a> {
    increments: &'a [Vec<Vector3<f64>>],
    options: &'a HeaterOptions,
}

impl Learning<'_> {
    /// So many vectors, signs open, from the steps that the edges of vectors known already leave.
    fn guess(&self, courses: &[Course], known: &[Vector3<f64>], heaters: usize) -> Option<Vec<Vector3<f64>>> {
        let profile = self.options.profile();
        let steps: Vec<_> = (0..courses.len())
            .into_par_iter()
            .flat_map_iter(|index| {
                let Course { edges, background } = &courses[index];
                let evidence = Evidence { increments: &self.increments[index], background, profile };
                classes::steps(index, &Evidence { increments: &evidence.without(edges, known), background, profile })
            })
            .collect();
        classes::guess(&steps, courses.len(), heaters)
    }

    /// The courses of first vectors, about whose polarity and times in a state nothing is known, and what these say of the
    /// classes, with the backgrounds that follow. Gives a measure of how probable this is first.
    fn first(&self, before: &[Course], vectors_nt: &[Vector3<f64>]) -> (f64, Vec<Course>, Vec<HeaterClass>) {
        let dwells = vec![Dwell::constant(FIRST_HAZARD); vectors_nt.len()];
        let profile = self.options.profile();
        let courses: Vec<Course> = self
            .increments
            .par_iter()
            .zip(before)
            .map(|(increments, Course { background, .. })| {
                let evidence = Evidence { increments, background, profile };
                let (_, edges) = courses::most_probable(&evidence, vectors_nt, &dwells, None, Ends::Free);
                Course { edges, background: background.clone() }
            })
            .collect();
        let classes = self.summarise(&courses);
        let (score, courses) = self.weighed(courses, &classes);
        (score, courses, classes)
    }

    /// How probable courses with their classes are, and the courses with the backgrounds that follow.
    fn weighed(&self, courses: Vec<Course>, classes: &[HeaterClass]) -> (f64, Vec<Course>) {
        let vectors = super::vectors(classes);
        let profile = self.options.profile();
        let (scores, courses): (Vec<f64>, Vec<Course>) = self
            .increments
            .par_iter()
            .zip(courses)
            .map(|(increments, Course { edges, background })| {
                let left = Evidence { increments, background: &background, profile }.without(&edges, &vectors);
                let background = Background::of(&left, self.options.order);
                let score = background.log_likelihood(&left) - EDGE_COST * edges.len() as f64;
                (score, Course { edges, background })
            })
            .unzip();
        (scores.iter().sum(), courses)
    }

    /// How probable courses are when their edges have the length of these options, at their best times and with the vectors that follow.
    fn moved(&self, found: &[Course], classes: &[HeaterClass]) -> f64 {
        let (mut courses, mut classes) = (found.to_vec(), classes.to_vec());
        for _ in 0..ROUNDS {
            let vectors = super::vectors(&classes);
            courses.par_iter_mut().zip(self.increments).for_each(|(course, increments)| {
                let evidence = Evidence { increments, background: &course.background, profile: self.options.profile() };
                evidence.refine(&mut course.edges, &vectors, f64::INFINITY, REACH_CELLS);
            });
            classes = self.summarise(&courses);
        }
        self.weighed(courses, &classes).0
    }

    /// Turns the vectors whose intervals begin or end with a heater on more often than off. Gives those for which that is even.
    fn turn(&self, classes: &mut [HeaterClass], courses: &mut [Course]) -> Vec<usize> {
        let mut even = Vec::new();
        for heater in 0..classes.len() {
            let vote = |edge: Option<&Edge>| edge.map_or(0, |edge| if edge.on { 1 } else { -1 });
            let votes: i32 = courses
                .iter()
                .map(|course| {
                    let mut own = course.edges.iter().filter(|edge| edge.heater == heater);
                    let first = vote(own.next());
                    first - vote(own.next_back())
                })
                .sum();
            match votes.signum() {
                -1 => invert(classes, courses, heater),
                0 if classes[heater].edges > 0 => even.push(heater),
                _ => {}
            }
        }
        even
    }

    /// Decides a polarity by the probability of the whole course; a heater for which this is not clear is left alone.
    fn decide(&self, classes: &mut [HeaterClass], courses: &mut [Course], heater: usize) {
        let score = |classes: &[HeaterClass]| -> f64 {
            let vectors = super::vectors(classes);
            let dwells: Vec<Dwell> = classes.iter().map(|class| super::dwell(class, self.options)).collect();
            let of = |(increments, Course { edges, background }): (&Vec<Vector3<f64>>, &Course)| {
                let evidence = Evidence { increments, background, profile: self.options.profile() };
                let present: Vec<usize> =
                    (0..vectors.len()).filter(|&heater| edges.iter().any(|edge| edge.heater == heater)).collect();
                courses::most_probable(&evidence, &vectors, &dwells, Some(&present), Ends::Off).0
            };
            self.increments.par_iter().zip(&*courses).map(of).collect::<Vec<f64>>().iter().sum()
        };
        let as_is = score(classes);
        let mut other = classes.to_vec();
        invert(&mut other, &mut [], heater);
        let gain = score(&other) - as_is;
        if gain > 0.0 {
            invert(classes, courses, heater);
        }
        if gain.abs() < CLEAR {
            classes[heater].vector_nt = [0.0; 3];
        }
    }

    /// The next courses and classes.
    fn next(&self, found: &[Course], classes: &[HeaterClass], same: bool, ends: Ends) -> (Vec<Course>, Vec<HeaterClass>) {
        let vectors = super::vectors(classes);
        let dwells: Vec<Dwell> = classes.iter().map(|class| super::dwell(class, self.options)).collect();
        let courses: Vec<Course> = self
            .increments
            .par_iter()
            .zip(found)
            .map(|(increments, course)| {
                let mut course = courses::next(increments, course, &vectors, &dwells, same, ends, self.options);
                let evidence = Evidence { increments, background: &course.background, profile: self.options.profile() };
                evidence.refine(&mut course.edges, &vectors, f64::INFINITY, REACH_CELLS);
                course
            })
            .collect();
        let classes = self.summarise(&courses);
        (courses, classes)
    }

    /// Class vectors and times in a state of the courses of all intervals.
    fn summarise(&self, courses: &[Course]) -> Vec<HeaterClass> {
        let Learning { increments, options } = *self;
        let parts: Vec<Normal> = increments
            .par_iter()
            .zip(courses)
            .map(|(increments, course)| {
                let mut normal = Normal::new(options.classes.len());
                normal.add(&Evidence { increments, background: &course.background, profile: options.profile() }, &course.edges);
                normal
            })
            .collect();
        let solved = parts.iter().fold(Normal::new(options.classes.len()), Normal::merge).solve();
        let mut classes = super::unknown(options);
        for (heater, (class, solved)) in classes.iter_mut().zip(solved).enumerate() {
            if let Some((vector, std)) = solved {
                (class.vector_nt, class.std_nt) = (vector.into(), std.into());
            }
            let mut times: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
            for course in courses {
                let own: Vec<&Edge> = course.edges.iter().filter(|edge| edge.heater == heater).collect();
                class.edges += own.len();
                own.windows(2)
                    .for_each(|pair| times[usize::from(pair[0].on)].push((pair[1].cell - pair[0].cell) * options.cell_s));
            }
            [class.off_s, class.on_s] = times.map(|mut times| {
                if times.len() < LEAST_TIMES {
                    return [f64::NAN; 2];
                }
                let middle = central_median(&mut times);
                times.iter_mut().for_each(|time| *time = (*time - middle).abs());
                [middle, central_median(&mut times) / 0.674_489_750_196]
            });
        }
        classes
    }
}
