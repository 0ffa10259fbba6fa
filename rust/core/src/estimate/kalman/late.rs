//! Sensors that are late: filters and delays inside them as states of the model.
//!
//! A reading with a filter or a delay inside the sensor is of the past. What the sensor holds becomes part of the state
//! (augmentation; Anderson and Moore 1979, section 11.3): the filter's output, and for a delay the outputs of the latest
//! samples, between which the one that is read is interpolated. Each is given its new value by the time update, from h at
//! the predicted state, so that to the measurement update the channel is a bias state and nothing else; smoother, gates and
//! missing readings need know nothing of it, and neither step nor run looks ahead.

use super::gaussian::{Gaussian, Symmetric};
use super::model::Linearised;
use crate::estimate::measurement::low_pass_or_none;
use crate::linear::{self, Real};

/// What is inside a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lateness {
    /// Time constant of a first-order filter [s]; 0 for none.
    pub time_constant: f64,
    /// Age of what is read [s].
    pub delay: f64,
    /// How many steps of time the delay can have, fractions included.
    pub steps: usize,
}

/// One late channel and where its states are.
#[derive(Clone, Copy, Debug)]
struct Line {
    /// Which channel it reads.
    channel: usize,
    /// Time constant and delay.
    inside: Lateness,
    /// Its input at the sample before; there with a filter.
    input: Option<usize>,
    /// Its output at the latest samples, the latest first: `steps` + 1 states.
    first: usize,
    /// What is read: interpolated, or the latest output.
    read: usize,
}

/// What a step of time does to the states of a line.
#[derive(Clone, Copy, Debug, Default)]
struct Weights {
    /// Of the filter's output before, of the input before, and of the input.
    filter: [f64; 3],
    /// Of the output at the sample `at` steps ago what is left by the one before it, of which `part` is read.
    at: usize,
    part: f64,
}

/// A late channel at the end of a step of time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LateChannel<'a> {
    pub(crate) channel: usize,
    /// The state that is read.
    pub(crate) state: usize,
    /// What its sensor sees, without bias, and how that depends on the state.
    pub(crate) prediction: f64,
    pub(crate) row: &'a [f64],
}

/// The late channels of a model, and their past.
///
/// A filter costs two states a channel, a delay as many as the samples that it spans and two. Channels that are not late
/// cost nothing.
#[derive(Clone, Debug)]
pub(super) struct Late {
    /// One a late channel.
    lines: Vec<Line>,
    /// Number of all states, the model's own first.
    states: usize,
    /// Times of the latest samples before now, the latest first [s].
    ages: Vec<f64>,
    /// What the step last taken did, one a line.
    weights: Vec<Weights>,
    /// Rows of late channels are empty here.
    biases: Vec<Option<usize>>,
    /// The bias of each channel as the model has it.
    own: Vec<Option<usize>>,
    /// h with the rows of late channels empty (channels), and its Jacobian (channels × dense).
    prediction: Vec<f64>,
    jacobian: Vec<f64>,
    /// Of the late channels where the time update linearised them (lines × dense).
    rows: Vec<f64>,
    row: Vec<f64>,
}

impl Late {
    /// What is inside the sensor of each channel, behind a model's own `states`, of which `dense` come first.
    pub(super) fn new(inside: &[Option<Lateness>], own: &[Option<usize>], states: usize, dense: usize) -> Self {
        let (mut lines, mut next, mut biases) = (Vec::new(), states, own.to_vec());
        for (channel, inside) in inside.iter().enumerate().filter_map(|(i, inside)| Some((i, (*inside)?))) {
            let input = (inside.time_constant > 0.0).then_some(next);
            let first = next + usize::from(input.is_some());
            let last = first + inside.steps;
            let read = if inside.delay > 0.0 { last + 1 } else { first };
            next = last.max(read) + 1;
            biases[channel] = Some(read);
            lines.push(Line { channel, inside, input, first, read });
        }
        let most = lines.iter().map(|line| line.inside.steps).max().unwrap_or(0);
        Self {
            ages: vec![0.0; most + 1],
            weights: vec![Weights::default(); lines.len()],
            rows: vec![0.0; lines.len() * dense],
            row: vec![0.0; next.next_multiple_of(linear::LANES)],
            prediction: vec![0.0; own.len()],
            jacobian: vec![0.0; own.len() * dense],
            own: own.to_vec(),
            states: next,
            biases,
            lines,
        }
    }

    /// The late channels, where the last step of time linearised them.
    pub(super) fn channels(&self) -> impl Iterator<Item = LateChannel<'_>> {
        let rows = self.rows.chunks_exact(self.dense());
        self.lines.iter().zip(rows).map(|(&Line { channel, read, .. }, row)| LateChannel {
            channel,
            state: read,
            prediction: self.prediction[channel],
            row,
        })
    }

    /// Number of all states.
    pub(super) fn states(&self) -> usize {
        self.states
    }

    /// How many states channels depend on, but for biases.
    fn dense(&self) -> usize {
        self.jacobian.len() / self.prediction.len()
    }

    /// The state that each channel is read with.
    pub(super) fn biases(&self) -> &[Option<usize>] {
        &self.biases
    }

    /// A recording's first belief with what sensors hold: they have settled at what they see there.
    pub(super) fn start(&mut self, belief: &mut Gaussian, at: Linearised<'_>) {
        if belief.mean.len() < self.states {
            let mut whole = Gaussian::independent(&vec![0.0; self.states]);
            whole.begin_with(belief);
            *belief = whole;
        }
        self.ages.fill(0.0);
        self.keep(at);
        for i in 0..self.lines.len() {
            let Line { input, first, read, inside, .. } = self.lines[i];
            for state in input.into_iter().chain(first..=first + inside.steps).chain([read]) {
                self.assign(belief, i, state, &[], 1.0);
            }
        }
    }

    /// Sensors take their next value after a step of `dt`, channels being linearised `at` the predicted mean.
    #[inline(always)]
    pub(super) fn advance(&mut self, belief: &mut Gaussian, at: Linearised<'_>, dt: f64) {
        for i in (1..self.ages.len()).rev() {
            self.ages[i] = self.ages[i - 1] + dt;
        }
        self.keep(at);
        for i in 0..self.lines.len() {
            self.weights[i] = self.weigh(self.lines[i].inside, dt);
            for (state, terms, factor) in steps(self.lines[i], self.weights[i]) {
                self.assign(belief, i, state, &terms, factor);
            }
        }
    }

    fn weigh(&self, Lateness { time_constant, delay, steps }: Lateness, dt: f64) -> Weights {
        let filter = low_pass_or_none(time_constant, dt);
        let at = (0..steps).rev().find(|&i| self.ages[i] <= delay).unwrap_or(0);
        let (age, span) = (self.ages[at], self.ages.get(at + 1).map_or(0.0, |older| older - self.ages[at]));
        let part = if span > 0.0 { ((delay - age) / span).clamp(0.0, 1.0) } else { 0.0 };
        Weights { filter, at, part }
    }

    /// Keeps the late channels' rows.
    #[inline(always)]
    fn keep(&mut self, at: Linearised<'_>) {
        let dense = self.dense();
        let Self { lines, rows, prediction, .. } = self;
        for (row, line) in rows.chunks_exact_mut(dense).zip(lines) {
            row.copy_from_slice(&at.jacobian[line.channel * dense..][..dense]);
        }
        prediction.copy_from_slice(at.prediction);
    }

    /// `state` ← Σ terms + `factor` (h + bias) of line `i`, in mean and covariance.
    #[inline(always)]
    fn assign(&mut self, belief: &mut Gaussian, i: usize, state: usize, terms: &[(usize, f64)], factor: f64) {
        let dense = self.dense();
        let Self { lines, rows, row, prediction, own, .. } = self;
        let (channel, h) = (lines[i].channel, &rows[i * dense..][..dense]);
        let bias = own[channel].map(|b| (b, factor));
        let Gaussian { mean, covariance } = belief;
        let stride = covariance.stride;
        row.fill(0.0);
        let (mut value, mut variance) = (factor * prediction[channel], 0.0);
        for &(j, weight) in terms.iter().chain(&bias) {
            linear::add_scaled(row, weight, &covariance.data[j * stride..][..stride]);
            value += weight * mean[j];
        }
        if factor != 0.0 {
            for (slope, own) in h.iter().zip(covariance.data.chunks_exact(stride)) {
                linear::add_scaled(row, factor * slope, own);
            }
            variance += factor * linear::dot(h, row);
        }
        for &(j, weight) in terms.iter().chain(&bias) {
            variance += weight * row[j];
        }
        row[state] = variance;
        for (r, value) in row[..mean.len()].iter().enumerate() {
            covariance.put(state, r, *value);
        }
        mean[state] = value;
    }

    /// What a measurement update sees: late channels are states.
    #[inline(always)]
    pub(super) fn mask(&mut self, at: Linearised<'_>) {
        self.prediction.copy_from_slice(at.prediction);
        self.jacobian.copy_from_slice(at.jacobian);
        let dense = self.dense();
        for line in &self.lines {
            self.prediction[line.channel] = 0.0;
            self.jacobian[line.channel * dense..][..dense].fill(0.0);
        }
    }

    /// What [`mask`](Self::mask) left.
    #[inline(always)]
    pub(super) fn masked(&self) -> Linearised<'_> {
        Linearised { prediction: &self.prediction, jacobian: &self.jacobian }
    }

    /// Columns of sensitivities through [`advance`](Self::advance), `driven` being those of the channels themselves.
    #[inline(always)]
    pub(super) fn carry<T: Real>(&self, columns: &mut [T], stride: usize, driven: Option<&[T]>) {
        let dense = self.dense();
        for (i, line) in self.lines.iter().enumerate() {
            let h = &self.rows[i * dense..][..dense];
            for (state, terms, factor) in steps(*line, self.weights[i]) {
                let bias = self.own[line.channel].map(|b| (b, factor));
                for c in 0..stride {
                    let mut sum =
                        driven.map_or(T::default(), |driven| T::of(factor) * driven[line.channel * stride + c]);
                    for (j, weight) in terms.into_iter().chain(bias) {
                        sum += T::of(weight) * columns[j * stride + c];
                    }
                    if factor != 0.0 {
                        for (j, slope) in h.iter().enumerate() {
                            sum += T::of(factor * slope) * columns[j * stride + c];
                        }
                    }
                    columns[state * stride + c] = sum;
                }
            }
        }
    }

    /// The adjoint of [`carry`](Self::carry) for a step that [`remember`](Self::remember) wrote.
    #[inline(always)]
    pub(super) fn carry_back(&self, memory: &[f64], columns: &mut [f64], stride: usize) {
        for (line, h, weights) in self.remembered(memory).rev() {
            for (state, terms, factor) in steps(line, weights).rev() {
                let bias = self.own[line.channel].map(|b| (b, factor));
                for c in 0..stride {
                    let pulled = core::mem::take(&mut columns[state * stride + c]);
                    for (j, weight) in terms.into_iter().chain(bias) {
                        columns[j * stride + c] += weight * pulled;
                    }
                    for (j, slope) in h.iter().enumerate() {
                        columns[j * stride + c] += factor * slope * pulled;
                    }
                }
            }
        }
    }

    /// To the measurement update late channels are states: a parameter acts on them by way of these.
    #[inline(always)]
    pub(super) fn mask_signatures(&self, stride: usize, out: &mut [f64]) {
        for line in &self.lines {
            out[line.channel * stride..][..stride].fill(0.0);
        }
    }

    /// How many numbers [`remember`](Self::remember) writes.
    pub(super) fn memory(&self) -> usize {
        self.rows.len() + 5 * self.lines.len()
    }

    /// What [`retreat`](Self::retreat) needs of a step.
    #[inline(always)]
    pub(super) fn remember(&self, memory: &mut Vec<f64>) {
        memory.extend_from_slice(&self.rows);
        for Weights { filter, at, part } in &self.weights {
            memory.extend_from_slice(filter);
            memory.extend_from_slice(&[*at as f64, *part]);
        }
    }

    /// Each line with its row and its weights, as [`remember`](Self::remember) wrote them.
    #[inline(always)]
    fn remembered<'a>(&'a self, memory: &'a [f64]) -> impl DoubleEndedIterator<Item = (Line, &'a [f64], Weights)> + 'a {
        let (rows, weights) = memory.split_at(self.rows.len());
        let each = self.lines.iter().zip(rows.chunks_exact(self.dense())).zip(weights.chunks_exact(5));
        each.map(|((line, h), w)| (*line, h, Weights { filter: [w[0], w[1], w[2]], at: w[3] as usize, part: w[4] }))
    }

    /// The adjoint of [`advance`](Self::advance): λ ← Tᵀ λ, Λ ← Tᵀ Λ T.
    #[inline(always)]
    pub(super) fn retreat(&self, memory: &[f64], lambda: &mut [f64], big: &mut Symmetric) {
        for (line, h, weights) in self.remembered(memory).rev() {
            for (state, terms, factor) in steps(line, weights).rev() {
                let bias = self.own[line.channel].map(|b| (b, factor));
                let inputs = h.iter().map(|slope| factor * slope).enumerate();
                undo(lambda, big, state, terms.into_iter().chain(bias).chain(inputs.filter(|_| factor != 0.0)));
            }
        }
    }
}

/// Assignments of a line's step, in order: a state, what of other states it becomes, and what of the input.
fn steps(line: Line, weights: Weights) -> impl DoubleEndedIterator<Item = (usize, [(usize, f64); 2], f64)> {
    let Line { inside, input, first, read, .. } = line;
    let Weights { filter: [before, last, now], at, part } = weights;
    let none = (first, 0.0);
    let shifts = (1..=inside.steps).rev().map(move |i| (first + i, [(first + i - 1, 1.0), none], 0.0));
    let output = match input {
        Some(input) => (first, [(first, before), (input, last)], now),
        None => (first, [none; 2], 1.0),
    };
    let kept = input.map(|input| (input, [none; 2], 1.0));
    let found = (read != first).then_some((read, [(first + at, 1.0 - part), (first + at + 1, part)], 0.0));
    shifts.chain([output]).chain(kept).chain(found)
}

/// The adjoint of `state` ← Σ `terms`.
fn undo(lambda: &mut [f64], big: &mut Symmetric, state: usize, terms: impl Iterator<Item = (usize, f64)> + Clone) {
    let stride = big.stride;
    let own: f64 = terms.clone().filter(|(j, _)| *j == state).map(|(_, weight)| weight).sum();
    let others = terms.filter(|(j, weight)| *j != state && *weight != 0.0);
    for (j, weight) in others.clone() {
        lambda[j] += weight * lambda[state];
        for k in 0..stride {
            big.data[j * stride + k] += weight * big.data[state * stride + k];
        }
    }
    lambda[state] *= own;
    big.data[state * stride..][..stride].iter_mut().for_each(|entry| *entry *= own);
    for row in big.data.chunks_exact_mut(stride) {
        for (j, weight) in others.clone() {
            row[j] += weight * row[state];
        }
        row[state] *= own;
    }
}

#[cfg(test)]
mod tests;
