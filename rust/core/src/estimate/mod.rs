//! Estimators: a model and a method.

pub mod observer;
