//! The regressions over the last samples of a stream, of which any lag is a few.
//!
//! Steps are kept in blocks of half a lag. Of the present block there is one [`Regression`] over all its steps so far, of the block before it one
//! over all, and of the one before that, in which the state is that a lag ends at, one from each step to the block's end. A step more
//! joins two pairs: it goes on with the present block, and goes one step back in the block before it.

use super::model::Model;
use super::regression::{Belief, Regression, RegressionRoom};
use core::mem::swap;

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct LagWindow {
    lag: usize,
    /// Steps in a block.
    block: usize,
    /// Steps so far.
    count: usize,
    /// Three blocks of steps; in a block that is complete, from the last one back, each is to the block's end.
    steps: Vec<Regression>,
    /// Over the present block so far, and over all of the one before.
    present: Regression,
    last: Regression,
    /// Room for what is joined, and for states on the way.
    joined: Regression,
    way: [Belief; 2],
    scratch: RegressionRoom,
}

impl LagWindow {
    /// For a lag of at least one step.
    pub(super) fn new(lag: usize, states: usize, parameters: usize) -> Self {
        let block = lag.div_ceil(2);
        let none = Regression::new(states, parameters);
        let belief = || Belief::new(states, parameters);
        Self {
            lag,
            block,
            count: 0,
            steps: vec![none.clone(); 3 * block],
            present: none.clone(),
            last: none.clone(),
            joined: none,
            way: [belief(), belief()],
            scratch: RegressionRoom::new(states, parameters),
        }
    }

    /// Forgets all steps.
    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// Takes the step that `model` last predicted; see [`Regression::of_step`].
    pub(super) fn push(&mut self, model: &mut impl Model, passed: (&[f64], f64), before: &Belief, predicted: &Belief) {
        let (slots, position) = (self.steps.len(), self.count % self.block);
        let Self { steps, present, last, joined, scratch, .. } = self;
        let step = &mut steps[self.count % slots];
        step.of_step(model, passed, before, predicted, scratch);
        if position == 0 {
            swap(present, last);
            present.copy_from(step);
        } else {
            present.join(step, scratch, joined);
            swap(present, joined);
        }
        if let Some(back) = (self.block - 1).checked_sub(position + 1).filter(|_| self.count >= self.block) {
            let at = (self.count - position - self.block + back) % slots;
            steps[at].join(&steps[at + 1], scratch, joined);
            swap(&mut steps[at], joined);
        }
        self.count += 1;
    }

    /// What `now` says of the state a lag ago, if there are as many steps.
    pub(super) fn earlier(&mut self, now: &Belief) -> Option<&Belief> {
        let (slots, first) = (self.steps.len(), self.count.checked_sub(self.lag)?);
        let begin = (self.count - 1) / self.block * self.block;
        let Self { steps, present, last, way: [at, next], scratch, .. } = self;
        present.apply(now, scratch, at);
        if first + self.block <= begin {
            last.apply(at, scratch, next);
            swap(at, next);
        }
        if first < begin && first + self.block != begin {
            steps[first % slots].apply(at, scratch, next);
            swap(at, next);
        }
        Some(at)
    }

    /// What `now` says of the states less than a lag ago, the earliest first and `now` last.
    pub(super) fn rest(&mut self, now: &Belief) -> Vec<Belief> {
        let (slots, block) = (self.steps.len(), self.block);
        let kept = self.count.min(self.lag - 1);
        let newest = self.count.saturating_sub(1);
        let (first, begin) = (self.count - kept, newest / block * block);
        // The block before the present one is turned as far as the present one has come: from its last step but one.
        let single = begin.saturating_sub(block)..begin.saturating_sub(2 + newest % block);
        let mut states = vec![now.clone(); kept + 1];
        for i in (first..self.count).rev() {
            let to = if i >= begin || single.contains(&i) { i + 1 } else { (i / block + 1) * block };
            let (earlier, later) = states.split_at_mut(i + 1 - first);
            self.steps[i % slots].apply(&later[to - i - 1], &mut self.scratch, &mut earlier[i - first]);
        }
        states
    }
}
