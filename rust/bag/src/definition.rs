//! Message definitions as ROS 2 writes them (`ros2msg`): the message itself, then those that it is made of.

use crate::cdr::Primitive;
use crate::error::BagError;
use crate::known;
use std::collections::HashMap;

/// Messages inside messages, at most.
const DEEPEST: usize = 32;

/// What a field holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value {
    Number(Primitive),
    Text,
    WideText,
    /// One of the definition's messages.
    Message(usize),
}

/// How many of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Count {
    One,
    Fixed(usize),
    Sequence,
}

/// A field of a message.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Field {
    pub(crate) name: String,
    pub(crate) value: Value,
    pub(crate) count: Count,
}

/// A type of messages, and all that it is made of.
#[derive(Debug)]
pub(crate) struct Definition {
    /// The first one is the type itself.
    pub(crate) messages: Vec<Vec<Field>>,
}

impl Definition {
    /// Reads the text of a definition, where there is one; what it lacks is looked for among common messages.
    pub(crate) fn parse(message: &str, text: Option<&str>) -> Result<Self, BagError> {
        let mut sections = sections(message, text.unwrap_or_default());
        if text.is_some() && known::definition(&short(message)).is_none() {
            sections.entry(short(message)).or_default(); // a message without fields has a text without lines
        }
        let mut parser = Parser { sections, indices: HashMap::new(), messages: Vec::new() };
        parser.message(&short(message), 0).map_err(|what| BagError::Definition { message: message.into(), what })?;
        Ok(Self { messages: parser.messages })
    }

    /// Whether a message is `builtin_interfaces/Time`, by what it holds.
    pub(crate) fn is_time(&self, message: usize) -> bool {
        let is = |field: &Field, name, kind| {
            field.name == name && field.value == Value::Number(kind) && field.count == Count::One
        };
        matches!(&self.messages[message][..], [sec, nanosec]
            if is(sec, "sec", Primitive::I32) && is(nanosec, "nanosec", Primitive::U32))
    }
}

/// `package/Type` of `package/msg/Type`.
fn short(message: &str) -> String {
    message.replacen("/msg/", "/", 1)
}

/// The text of each message, by its type.
fn sections<'a>(message: &str, text: &'a str) -> HashMap<String, Vec<&'a str>> {
    let mut name = short(message);
    let mut sections = HashMap::<String, Vec<&str>>::new();
    for line in text.lines() {
        let line = without_comment(line).trim();
        if let Some(next) = line.strip_prefix("MSG:") {
            name = short(next.trim());
            sections.entry(name.clone()).or_default();
        } else if !line.is_empty() && !line.starts_with("===") {
            sections.entry(name.clone()).or_default().push(line);
        }
    }
    sections
}

/// A `#` inside a text, as a default value, begins no comment.
fn without_comment(line: &str) -> &str {
    let mut quote = None;
    for (at, character) in line.char_indices() {
        match (character, quote) {
            ('#', None) => return &line[..at],
            ('"' | '\'', None) => quote = Some(character),
            (_, Some(open)) if open == character => quote = None,
            _ => {}
        }
    }
    line
}

struct Parser<'a> {
    sections: HashMap<String, Vec<&'a str>>,
    indices: HashMap<String, Option<usize>>,
    messages: Vec<Vec<Field>>,
}

impl Parser<'_> {
    /// The index of a message, which is read when it is first needed.
    fn message(&mut self, name: &str, depth: usize) -> Result<usize, String> {
        match self.indices.get(name) {
            Some(Some(index)) => return Ok(*index),
            Some(None) => return Err(format!("'{name}' holds itself")),
            None if depth > DEEPEST => return Err(format!("messages nest more than {DEEPEST} deep")),
            None => {}
        }
        let lines = match (self.sections.remove(name), known::definition(name)) {
            (Some(lines), _) => lines,
            (None, Some(text)) => text.lines().map(str::trim).collect(),
            (None, None) => return Err(format!("'{name}' is not defined in the bag")),
        };
        self.indices.insert(name.into(), None);
        let index = self.messages.len();
        self.messages.push(Vec::new());
        let package = name.rsplit_once('/').map_or("", |(package, _)| package);
        let mut fields = Vec::new();
        for line in lines {
            fields.extend(self.field(line, package, depth)?);
        }
        if fields.is_empty() {
            // An empty structure is one byte.
            let name = "structure_needs_at_least_one_member".into();
            fields.push(Field { name, value: Value::Number(Primitive::U8), count: Count::One });
        }
        self.messages[index] = fields;
        self.indices.insert(name.into(), Some(index));
        Ok(index)
    }

    /// `type name`, perhaps with a default; constants, `TYPE NAME=VALUE`, are not serialised.
    fn field(&mut self, line: &str, package: &str, depth: usize) -> Result<Option<Field>, String> {
        let (kind, rest) = line.split_once(char::is_whitespace).ok_or_else(|| format!("'{line}' is no field"))?;
        let rest = rest.trim_start();
        let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
        let (name, after) = rest.split_at(end);
        if after.trim_start().starts_with('=') {
            return Ok(None);
        }
        if name.is_empty() {
            return Err(format!("'{line}' is no field"));
        }
        let (base, count) = counted(kind)?;
        let value = match base.split_once("<=").map_or(base, |(base, _)| base) {
            "string" => Value::Text,
            "wstring" => Value::WideText,
            base => match Primitive::named(base) {
                Some(primitive) => Value::Number(primitive),
                None => Value::Message(self.message(&self.full(base, package), depth + 1)?),
            },
        };
        Ok(Some(Field { name: name.into(), value, count }))
    }

    /// The full name of a type: one without a package is of that of the message around it.
    fn full(&self, base: &str, package: &str) -> String {
        let base = short(base);
        match base.as_str() {
            "Header" => "std_msgs/Header".into(),
            _ if base.contains('/') || package.is_empty() => base,
            _ => format!("{package}/{base}"),
        }
    }
}

/// A type without its `[…]`, and what that says.
fn counted(kind: &str) -> Result<(&str, Count), String> {
    let Some((base, size)) = kind.strip_suffix(']').and_then(|kind| kind.split_once('[')) else {
        return Ok((kind, Count::One));
    };
    match size.parse() {
        _ if size.is_empty() || size.starts_with("<=") => Ok((base, Count::Sequence)),
        Ok(count) if count > 0 => Ok((base, Count::Fixed(count))),
        _ => Err(format!("'{kind}' has no size that can be understood")),
    }
}
