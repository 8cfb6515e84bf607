//! The same work for every run of many.

use std::iter::Enumerate;
use std::sync::{Mutex, PoisonError};

/// Does the same with every item, several at a time, and gives what came out in their order.
///
/// Each thread takes the next item once it is done with one. Were the items jobs of the thread pool, a thread that waits inside one of them
/// for others, of a figure or a table, would begin the next item meanwhile, within that the next, and so on: among hundreds of runs until
/// its stack is full.
pub fn each<I, R>(items: I, work: impl Fn(I::Item) -> R + Sync) -> Vec<R>
where
    I: IntoIterator<IntoIter: Send>,
    R: Send,
{
    let next = Mutex::new(items.into_iter().enumerate());
    let done = Mutex::new(Vec::new());
    rayon::scope(|scope| {
        for _ in 0..rayon::current_num_threads() {
            scope.spawn(|_| {
                while let Some((index, item)) = taken(&next) {
                    let result = work(item);
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

fn taken<I: Iterator>(next: &Mutex<Enumerate<I>>) -> Option<(usize, I::Item)> {
    next.lock().unwrap_or_else(PoisonError::into_inner).next()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    /// How deep items are begun inside each other is at most the number of threads, whatever they wait for.
    #[test]
    fn items_are_not_nested_in_each_other() {
        thread_local!(static DEPTH: std::cell::Cell<usize> = const { std::cell::Cell::new(0) });
        let other = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let deepest = pool.install(|| {
            each(0..200_u64, |k| {
                DEPTH.set(DEPTH.get() + 1);
                let depth = DEPTH.get();
                // A thread of a pool that waits for another pool takes what it finds in its own.
                let sum: u64 = other.install(|| (0..50_u64).into_par_iter().map(|i| i * k).sum());
                assert_eq!(sum, 1225 * k);
                DEPTH.set(depth - 1);
                depth
            })
        });
        assert_eq!(deepest.len(), 200);
        assert!(deepest.iter().all(|depth| *depth <= 2), "{deepest:?}");
    }

    #[test]
    fn results_have_the_order_of_the_items() {
        assert_eq!(each(vec![3, 1, 2], |i| 10 * i), [30, 10, 20]);
        let mut list = [1, 2];
        each(list.iter_mut(), |i| *i += 1);
        assert_eq!(list, [2, 3]);
    }
}
