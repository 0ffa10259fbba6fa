//! Estimators: a model and a method.
