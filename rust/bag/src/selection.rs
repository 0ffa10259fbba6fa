//! What to take from each message of a type: paths of fields, compiled into a walk over the message.

use crate::cdr::{Cursor, Wrong};
use crate::definition::{Count, Definition, Field, Value};

/// What to take from a field, or from an element of it.
#[derive(Debug, Default)]
enum Take {
    #[default]
    Nothing,
    /// The number itself, into this slot.
    Number(usize),
    /// Parts of a message, by field.
    Parts(Vec<Take>),
    /// Single elements, by index.
    Elements(Vec<(usize, Take)>),
    /// All numbers of an array, into this list.
    List(usize),
    /// All texts of an array.
    Names,
}

/// A step along a path: `.name` or `[index]`.
#[derive(Debug)]
enum Step<'a> {
    Name(&'a str),
    Index(usize),
}

/// A walk over messages of one type.
#[derive(Debug)]
pub(crate) struct Selection {
    definition: Definition,
    root: Vec<Take>,
    /// Slots of seconds and nanoseconds, where messages carry a stamp.
    stamp: Option<(usize, usize)>,
    paths: Vec<String>,
    lists: usize,
}

/// What was taken from a message.
#[derive(Debug, Default)]
pub(crate) struct Taken {
    pub(crate) numbers: Vec<f64>,
    pub(crate) lists: Vec<Vec<f64>>,
    /// Names, as they are written, and how many they are.
    pub(crate) names: Vec<u8>,
    pub(crate) count: usize,
    pub(crate) big_endian: bool,
}

impl Selection {
    /// Finds the stamp: of the header, or beside the fields.
    pub(crate) fn new(definition: Definition) -> Self {
        let root = definition.messages[0].iter().map(|_| Take::Nothing).collect();
        let mut new = Self { definition, root, stamp: None, paths: Vec::new(), lists: 0 };
        let stamp = ["header.stamp", "stamp"].into_iter().find(|path| new.leads_to_time(path));
        new.stamp = stamp.and_then(|path| {
            Some((new.number(&format!("{path}.sec")).ok()?, new.number(&format!("{path}.nanosec")).ok()?))
        });
        new
    }

    fn leads_to_time(&self, path: &str) -> bool {
        let mut message = 0;
        for name in path.split('.') {
            let field = self.definition.messages[message].iter().find(|field| field.name == name);
            match field.map(|field| (field.value, field.count)) {
                Some((Value::Message(inner), Count::One)) => message = inner,
                _ => return false,
            }
        }
        self.definition.is_time(message)
    }

    /// Takes a number; gives its slot.
    pub(crate) fn number(&mut self, path: &str) -> Result<usize, String> {
        if let Some(slot) = self.paths.iter().position(|known| known == path) {
            return Ok(slot);
        }
        self.add(path, Take::Number(self.paths.len()))?;
        self.paths.push(path.into());
        Ok(self.paths.len() - 1)
    }

    /// Takes all numbers of an array; lists are numbered as they are asked for.
    pub(crate) fn list(&mut self, path: &str) -> Result<(), String> {
        self.add(path, Take::List(self.lists))?;
        self.lists += 1;
        Ok(())
    }

    /// Takes the texts of an array.
    pub(crate) fn names(&mut self, path: &str) -> Result<(), String> {
        self.add(path, Take::Names)
    }

    fn add(&mut self, path: &str, take: Take) -> Result<(), String> {
        let steps = steps(path)?;
        let root = Value::Message(0);
        let mut whole = Take::Parts(core::mem::take(&mut self.root));
        let outcome = insert(&self.definition, &mut whole, root, Count::One, &steps, take);
        if let Take::Parts(root) = whole {
            self.root = root;
        }
        outcome.map_err(|why| format!("'{path}' {why}"))
    }

    /// Reads a message.
    pub(crate) fn read(&self, message: &[u8], taken: &mut Taken) -> Result<(), Wrong> {
        taken.numbers.clear();
        taken.numbers.resize(self.paths.len(), f64::NAN);
        taken.lists.resize_with(self.lists, Vec::new);
        taken.lists.iter_mut().for_each(Vec::clear);
        let mut cursor = Cursor::new(message)?;
        let used = self.root.iter().rposition(|take| !matches!(take, Take::Nothing)).map_or(0, |last| last + 1);
        self.parts(0, &self.root[..used], &mut cursor, taken)
    }

    /// The stamp of the message last read [ns].
    pub(crate) fn stamp(&self, taken: &Taken) -> Option<i64> {
        let (sec, nanosec) = self.stamp?;
        Some(taken.numbers[sec] as i64 * 1_000_000_000 + taken.numbers[nanosec] as i64)
    }

    fn parts(&self, message: usize, takes: &[Take], cursor: &mut Cursor<'_>, taken: &mut Taken) -> Result<(), Wrong> {
        for (field, take) in self.definition.messages[message].iter().zip(takes) {
            match (field.count, take) {
                (_, Take::Nothing) => self.pass(field.value, self.length(field, cursor)?, cursor)?,
                (Count::One, take) => self.one(field.value, take, cursor, taken)?,
                (_, take) => self.array(field.value, self.length(field, cursor)?, take, cursor, taken)?,
            }
        }
        Ok(())
    }

    fn length(&self, field: &Field, cursor: &mut Cursor<'_>) -> Result<usize, Wrong> {
        match field.count {
            Count::One => Ok(1),
            Count::Fixed(count) => Ok(count),
            Count::Sequence => cursor.count(),
        }
    }

    fn one(&self, value: Value, take: &Take, cursor: &mut Cursor<'_>, taken: &mut Taken) -> Result<(), Wrong> {
        match (value, take) {
            (Value::Number(kind), Take::Number(slot)) => taken.numbers[*slot] = cursor.number(kind)?,
            (Value::Message(inner), Take::Parts(takes)) => self.parts(inner, takes, cursor, taken)?,
            _ => self.pass(value, 1, cursor)?,
        }
        Ok(())
    }

    fn array(
        &self,
        value: Value,
        count: usize,
        take: &Take,
        cursor: &mut Cursor<'_>,
        taken: &mut Taken,
    ) -> Result<(), Wrong> {
        match (value, take) {
            (Value::Number(kind), Take::List(list)) => {
                for _ in 0..count {
                    taken.lists[*list].push(cursor.number(kind)?);
                }
            }
            (Value::Text, Take::Names) => {
                let begin = cursor.at();
                self.pass(value, count, cursor)?;
                taken.names.clear();
                taken.names.extend_from_slice(cursor.since(begin));
                (taken.count, taken.big_endian) = (count, cursor.big_endian());
            }
            (_, Take::Elements(elements)) => {
                let mut at = 0;
                for (index, take) in elements.iter().filter(|(index, _)| *index < count) {
                    self.pass(value, index - at, cursor)?;
                    self.one(value, take, cursor, taken)?;
                    at = index + 1;
                }
                self.pass(value, count - at, cursor)?;
            }
            _ => self.pass(value, count, cursor)?,
        }
        Ok(())
    }

    /// Skips values that are not wanted; each but the first takes a byte at least, so that this ends with the message.
    fn pass(&self, value: Value, count: usize, cursor: &mut Cursor<'_>) -> Result<(), Wrong> {
        match value {
            Value::Number(kind) => cursor.pass(kind, count)?,
            Value::Text => (0..count).try_for_each(|_| cursor.text().map(drop))?,
            Value::WideText if count > 0 => return Err("has a wstring ahead of what is wanted, which is not read"),
            Value::WideText => {}
            Value::Message(inner) => {
                for _ in 0..count {
                    for field in &self.definition.messages[inner] {
                        self.pass(field.value, self.length(field, cursor)?, cursor)?;
                    }
                }
            }
        }
        Ok(())
    }
}

fn steps(path: &str) -> Result<Vec<Step<'_>>, String> {
    let mut steps = Vec::new();
    for part in path.split('.') {
        let (name, mut rest) = part.split_at(part.find('[').unwrap_or(part.len()));
        steps.push(Step::Name(name));
        while !rest.is_empty() {
            let index = rest.strip_prefix('[').and_then(|rest| rest.split_once(']'));
            let (index, after) =
                index.ok_or_else(|| format!("'{path}' is no path, as in pose.position.x or data[3]"))?;
            steps.push(Step::Index(index.parse().map_err(|_| format!("'{path}': '{index}' is no index"))?));
            rest = after;
        }
    }
    Ok(steps)
}

/// Adds what a path leads to, beside what is taken already.
fn insert(
    definition: &Definition,
    into: &mut Take,
    value: Value,
    count: Count,
    steps: &[Step<'_>],
    take: Take,
) -> Result<(), String> {
    match (steps, count, value) {
        ([], Count::One, Value::Number(_)) if matches!(take, Take::Number(_)) => place(into, take),
        ([], Count::Fixed(_) | Count::Sequence, Value::Number(_)) if matches!(take, Take::List(_)) => place(into, take),
        ([], Count::Fixed(_) | Count::Sequence, Value::Text) if matches!(take, Take::Names) => place(into, take),
        ([], ..) => Err(format!("is {}: {} expected", described(value, count), wanted(&take))),
        ([Step::Index(index), rest @ ..], Count::Fixed(_) | Count::Sequence, _) => {
            if matches!(count, Count::Fixed(size) if *index >= size) {
                return Err(format!("has an index beyond {}", described(value, count)));
            }
            if matches!(into, Take::Nothing) {
                *into = Take::Elements(Vec::new());
            }
            let Take::Elements(elements) = into else { return Err("is taken in two ways".into()) };
            let at = elements.partition_point(|(known, _)| known < index);
            if elements.get(at).is_none_or(|(known, _)| known != index) {
                elements.insert(at, (*index, Take::Nothing));
            }
            insert(definition, &mut elements[at].1, value, Count::One, rest, take)
        }
        ([Step::Index(_), ..], ..) => Err(format!("has an index into {}", described(value, count))),
        ([Step::Name(name), rest @ ..], Count::One, Value::Message(inner)) => {
            let fields = &definition.messages[inner];
            let Some(at) = fields.iter().position(|field| field.name == *name) else {
                let names: Vec<_> = fields.iter().map(|field| field.name.as_str()).collect();
                return Err(format!("is no field: in place of '{name}' there are {}", names.join(", ")));
            };
            if matches!(into, Take::Nothing) {
                *into = Take::Parts(fields.iter().map(|_| Take::Nothing).collect());
            }
            let Take::Parts(parts) = into else { return Err("is taken in two ways".into()) };
            insert(definition, &mut parts[at], fields[at].value, fields[at].count, rest, take)
        }
        ([Step::Name(name), ..], ..) => Err(format!("is no field: {} has no '{name}'", described(value, count))),
    }
}

fn place(into: &mut Take, take: Take) -> Result<(), String> {
    match into {
        Take::Nothing => {
            *into = take;
            Ok(())
        }
        _ => Err("is taken in two ways".into()),
    }
}

fn described(value: Value, count: Count) -> String {
    let one = match value {
        Value::Number(_) => "number",
        Value::Text | Value::WideText => "text",
        Value::Message(_) => "message",
    };
    match count {
        Count::One => format!("a {one}"),
        Count::Fixed(count) => format!("an array of {count} {one}s"),
        Count::Sequence => format!("an array of {one}s"),
    }
}

fn wanted(take: &Take) -> &'static str {
    match take {
        Take::List(_) => "an array of numbers is",
        Take::Names => "an array of texts is",
        _ => "one number is",
    }
}
