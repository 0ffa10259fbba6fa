//! What an estimator gives: numbers by name.

/// Fields of an estimate, one after the other in memory that never moves.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fields {
    /// Name, and where the field begins; it ends where the next one does.
    table: Vec<(&'static str, usize)>,
    values: Vec<f64>,
}

impl Fields {
    /// A field of `width` numbers; none where it has no width.
    pub(crate) fn add(&mut self, name: &'static str, width: usize) {
        if width > 0 {
            self.table.push((name, self.values.len()));
            self.values.resize(self.values.len() + width, f64::NAN);
        }
    }

    /// The names of all.
    pub(crate) fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.table.iter().map(|(name, _)| *name)
    }

    /// The numbers of a field.
    pub(crate) fn get(&self, name: &str) -> Option<&[f64]> {
        let at = self.table.iter().position(|(own, _)| *own == name)?;
        let end = self.table.get(at + 1).map_or(self.values.len(), |(_, next)| *next);
        Some(&self.values[self.table[at].1..end])
    }

    /// No numbers: nothing has been estimated.
    pub(crate) fn clear(&mut self) {
        self.values.fill(f64::NAN);
    }

    /// All numbers anew, field by field as they were added.
    pub(crate) fn fill<'a>(&mut self, parts: impl IntoIterator<Item = &'a [f64]>) {
        let mut rest = &mut self.values[..];
        for part in parts {
            let (own, others) = rest.split_at_mut(part.len().min(rest.len()));
            own.copy_from_slice(&part[..own.len()]);
            rest = others;
        }
    }
}
