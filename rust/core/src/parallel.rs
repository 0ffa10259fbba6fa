//! All threads of the crate. Results never depend on how many there are.
//!
//! Threads for whole recordings live as long as the call, so that a forked process has what it needs. Blocks of particles
//! are too short for that: they go to a pool, one for each process that asks.

use crate::interrupt::Watch;
use core::num::NonZero;
use core::sync::atomic::{AtomicUsize, Ordering};
use core::time::Duration;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::{LazyLock, Mutex, OnceLock, PoisonError};
use std::thread;

/// Room on the stack of a thread, for kernels that are inlined whole; only what is used is taken.
const STACK: usize = 16 << 20;

/// How long a thread that waits for others sleeps until it asks whether to stop.
const NAP: Duration = Duration::from_millis(10);

/// Threads to use: as many as there are cores, or as the environment variable `RAYON_NUM_THREADS` says.
pub fn threads() -> usize {
    static THREADS: LazyLock<usize> = LazyLock::new(|| {
        let wanted = std::env::var("RAYON_NUM_THREADS").ok().and_then(|text| text.parse().ok()).filter(|&n| n > 0);
        wanted.unwrap_or_else(|| thread::available_parallelism().map_or(1, NonZero::get))
    });
    *THREADS
}

/// `f` of each item, in order, on all cores; the items should take milliseconds.
pub(crate) fn map<T: Sync, R: Send>(items: &[T], f: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let mut results: Vec<Option<R>> = items.iter().map(|_| None).collect();
    each(items.iter().zip(&mut results).collect(), |(item, result)| *result = Some(f(item)));
    results.into_iter().flatten().collect()
}

/// Calls `f` with each item, on all cores; the items should take milliseconds.
pub(crate) fn each<I: Send>(items: Vec<I>, f: impl Fn(I) + Sync) {
    // The caller works too: of one item there are no helpers, and nothing is spawned.
    let helpers = threads().min(items.len()).saturating_sub(1);
    let queue = Queue::new(items);
    let stop = Watch::current().shared();
    thread::scope(|scope| {
        for _ in 0..helpers {
            // A helper that cannot be had leaves its share to the others.
            let stop = stop.clone();
            let _ =
                thread::Builder::new().stack_size(STACK).spawn_scoped(scope, || Watch::follow(stop, || queue.work(&f)));
        }
        queue.work(&f);
        queue.wait();
    });
}

/// As [`each`], for items of microseconds, on the threads of a pool; items are left out once the work is to stop.
///
/// To start threads would take longer than the work: blocks of particles go to some that wait for them.
pub(crate) fn each_short<I: Send>(items: impl Iterator<Item = I> + Send, count: usize, f: impl Fn(I) + Sync) {
    let helpers = threads().min(count).saturating_sub(1);
    let f = |item| {
        if !Watch::current().stops() {
            f(item);
        }
    };
    let Some(pool) = (helpers > 0).then(pool).flatten() else { return items.for_each(f) };
    let queue = Queue::new(items);
    let stop = Watch::current().shared();
    pool.in_place_scope(|scope| {
        for _ in 0..helpers {
            let (stop, queue) = (stop.clone(), &queue);
            scope.spawn(move |_| Watch::follow(stop, || queue.work(f)));
        }
        queue.work(f);
        queue.wait();
    });
}

/// The pool of this process: its threads do not come along when it forks.
fn pool() -> Option<&'static ThreadPool> {
    struct Pool {
        process: u32,
        threads: Option<ThreadPool>,
        /// That of a child, and so on. Looked through without a lock, which a fork could leave closed.
        child: OnceLock<Box<Pool>>,
    }
    impl Pool {
        fn new() -> Self {
            let threads = ThreadPoolBuilder::new().num_threads(threads()).stack_size(STACK).build().ok();
            Self { process: std::process::id(), threads, child: OnceLock::new() }
        }
    }
    static FIRST: OnceLock<Pool> = OnceLock::new();
    let mut pool = FIRST.get_or_init(Pool::new);
    while pool.process != std::process::id() {
        pool = pool.child.get_or_init(|| Box::new(Pool::new()));
    }
    pool.threads.as_ref()
}

/// Items that threads take one after the other.
struct Queue<I> {
    /// Items that no thread has taken yet.
    items: Mutex<I>,
    /// Items taken and not yet done.
    busy: AtomicUsize,
    /// Who asked, to be woken by whoever is done last.
    waiting: thread::Thread,
}

impl<I: Iterator> Queue<I> {
    fn new(items: impl IntoIterator<IntoIter = I>) -> Self {
        Self { items: Mutex::new(items.into_iter()), busy: AtomicUsize::new(0), waiting: thread::current() }
    }

    /// The next item; its taker is busy from now on.
    fn take(&self) -> Option<I::Item> {
        let mut items = self.items.lock().unwrap_or_else(PoisonError::into_inner);
        self.busy.fetch_add(1, Ordering::Relaxed);
        items.next()
    }

    /// Takes items until there are none, and counts each as done even where `f` panics.
    fn work(&self, f: impl Fn(I::Item)) {
        struct Busy<'a, I>(&'a Queue<I>);
        impl<I> Drop for Busy<'_, I> {
            fn drop(&mut self) {
                if self.0.busy.fetch_sub(1, Ordering::Release) == 1 {
                    self.0.waiting.unpark();
                }
            }
        }
        loop {
            let item = self.take();
            let _busy = Busy(self);
            match item {
                Some(item) => f(item),
                None => return,
            }
        }
    }

    /// Waits for the others, asking now and then whether to stop.
    fn wait(&self) {
        let watch = Watch::current();
        while self.busy.load(Ordering::Acquire) > 0 {
            thread::park_timeout(NAP);
            watch.stops_while_idle();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_is_done_once_and_in_its_place() {
        let items: Vec<usize> = (0..100).collect();
        assert_eq!(map(&items, |i| i * i), items.iter().map(|i| i * i).collect::<Vec<_>>());
        let mut counts = vec![0; 1000];
        for _ in 0..50 {
            each_short(counts.iter_mut(), 1000, |count| *count += 1);
        }
        assert!(counts.iter().all(|&count| count == 50));
        map(&items, |_| map(&items, |i| each_short(0..*i, *i, |_| {})));
    }
}
