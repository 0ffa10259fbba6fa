//! Columns of numbers, gathered from messages.

use crate::cdr::{Cursor, Wrong};
use crate::definition::Definition;
use crate::error::BagError;
use crate::selection::{Selection, Taken};
use crate::unpack::unpack;
use std::collections::HashMap;

/// Names that the messages of a topic may have in all.
const MOST_NAMES: usize = 256;
/// Definitions that a topic may have.
const MOST_DEFINITIONS: usize = 16;
/// Bytes of a message that is compressed by itself.
const LARGEST: u64 = 64 << 20;

/// What is wanted of a topic.
#[derive(Clone, Debug)]
pub struct Request {
    /// The topic.
    pub topic: String,
    /// Paths of fields: a number each, or where there are names, an array each.
    pub paths: Vec<String>,
    /// The path of an array of names, to which the elements of those arrays belong.
    pub names: Option<String>,
    /// The names that are wanted; all by default.
    pub only: Option<Vec<String>>,
}

/// What was found for a request: a row a message.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// The stamp in the message, where its type has one [ns].
    pub stamps: Vec<i64>,
    /// When the message was recorded [ns].
    pub received: Vec<i64>,
    /// The names, in the order of their columns.
    pub names: Vec<String>,
    /// By path, or by path and name: the names of the first path, then those of the second.
    pub columns: Vec<Vec<f64>>,
}

/// How the messages of a topic are written, as the bag has it.
#[derive(Clone, Copy, Debug)]
pub struct Written<'a> {
    /// Their type, `package/msg/Type`.
    pub message: &'a str,
    /// How they are serialised: `cdr`.
    pub encoding: &'a str,
    /// The language of the definition: `ros2msg`, or nothing.
    pub language: &'a str,
    /// The definition.
    pub definition: &'a [u8],
}

/// A topic of a bag.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// The type of its messages.
    pub message: String,
    /// How many there are.
    pub count: u64,
    /// How they are written, one after the other.
    channels: Vec<usize>,
}

/// A topic as it is written, and what is taken from it.
#[derive(Debug)]
struct Channel {
    /// The topic's number.
    topic: usize,
    message: String,
    /// Kept where something is taken.
    definition: Vec<u8>,
    takers: Vec<Taker>,
}

/// What a request takes from a message: where numbers are, one after the other.
#[derive(Debug)]
struct Taker {
    request: usize,
    selection: Selection,
    slots: Vec<usize>,
}

/// Gathers what was requested.
#[derive(Debug, Default)]
pub struct Collector {
    requests: Vec<Request>,
    gathered: Vec<Gathered>,
    channels: Vec<Channel>,
    topics: Vec<Topic>,
    /// The number of each topic.
    numbers: HashMap<String, usize>,
    compressed: bool,
}

impl Collector {
    /// For some requests; `compressed` says that each message is compressed by itself, with zstd.
    #[must_use]
    pub fn new(requests: Vec<Request>, compressed: bool) -> Self {
        let gathered = requests.iter().map(Gathered::new).collect();
        Self { requests, gathered, compressed, ..Self::default() }
    }

    /// Says how a topic is written; gives the number by which its messages are [added](Self::add).
    ///
    /// # Errors
    ///
    /// A wanted topic that cannot be read, or lacks a wanted field.
    pub fn define(&mut self, topic: &str, written: Written<'_>) -> Result<usize, BagError> {
        let wanted = self.requests.iter().any(|request| request.topic == topic);
        let definition = if wanted { written.definition } else { &[] };
        let number = *self.numbers.entry(topic.into()).or_insert(self.topics.len());
        if number == self.topics.len() {
            self.topics.push(Topic { name: topic.into(), ..Topic::default() });
        }
        let known = &mut self.topics[number];
        known.message = written.message.into();
        let alike = |&&index: &&usize| {
            let channel: &Channel = &self.channels[index];
            channel.message == written.message && channel.definition == definition
        };
        if let Some(index) = known.channels.iter().find(alike) {
            return Ok(*index);
        }
        if known.channels.len() == MOST_DEFINITIONS {
            return Err(BagError::Many { topic: topic.into(), limit: MOST_DEFINITIONS, what: "definitions" });
        }
        let index = self.channels.len();
        known.channels.push(index);
        let takers = if wanted { self.takers(topic, written)? } else { Vec::new() };
        let (message, definition) = (written.message.into(), definition.into());
        self.channels.push(Channel { topic: number, message, definition, takers });
        Ok(index)
    }

    fn takers(&self, topic: &str, written: Written<'_>) -> Result<Vec<Taker>, BagError> {
        let refuse = |found: String, expected| Err(BagError::Encoding { topic: topic.into(), found, expected });
        if written.encoding != "cdr" {
            return refuse(format!("'{}'", written.encoding), "CDR of ROS 2");
        }
        if !matches!(written.language, "ros2msg" | "") {
            return refuse(format!("'{}'", written.language), "a definition as ros2msg");
        }
        let text = (!written.language.is_empty()).then(|| String::from_utf8_lossy(written.definition));
        let mut takers = Vec::new();
        for (index, request) in self.requests.iter().enumerate().filter(|(_, request)| request.topic == topic) {
            let selection = Selection::new(Definition::parse(written.message, text.as_deref())?);
            let refused = |what| BagError::Field { topic: topic.into(), message: written.message.into(), what };
            takers.push(Taker::new(index, selection, request).map_err(refused)?);
        }
        Ok(takers)
    }

    /// Takes what is wanted from a message, recorded at a time [ns].
    ///
    /// # Errors
    ///
    /// A message that is not what its definition says.
    pub fn add(&mut self, channel: usize, received: i64, data: &[u8]) -> Result<(), BagError> {
        let channel = &self.channels[channel];
        let topic = &mut self.topics[channel.topic];
        let index = topic.count;
        topic.count += 1;
        if channel.takers.is_empty() {
            return Ok(());
        }
        let wrong = |what| BagError::Message { topic: topic.name.clone(), index, what };
        let unpacked;
        let data = if self.compressed {
            unpacked = unpack(data, "zstd", LARGEST).map_err(|_| wrong("cannot be decompressed"))?;
            &unpacked
        } else {
            data
        };
        for taker in &channel.takers {
            let gathered = &mut self.gathered[taker.request];
            taker.selection.read(data, &mut gathered.taken).map_err(wrong)?;
            gathered.keep(taker, received).map_err(|fault| match fault {
                Fault::Wrong(what) => wrong(what),
                Fault::Many => BagError::Many { topic: topic.name.clone(), limit: MOST_NAMES, what: "names" },
            })?;
        }
        Ok(())
    }

    /// The topics seen so far, by name.
    #[must_use]
    pub fn topics(&self) -> Vec<&Topic> {
        let mut topics: Vec<_> = self.topics.iter().collect();
        topics.sort_by(|a, b| a.name.cmp(&b.name));
        topics
    }

    /// What was gathered, by request.
    #[must_use]
    pub fn finish(self) -> Vec<Series> {
        self.gathered.into_iter().map(Gathered::finish).collect()
    }
}

impl Taker {
    /// Numbers, or lists beside names.
    fn new(index: usize, mut selection: Selection, request: &Request) -> Result<Self, String> {
        let mut slots = Vec::new();
        if let Some(names) = &request.names {
            selection.names(names)?;
            request.paths.iter().try_for_each(|path| selection.list(path))?;
        } else {
            for path in &request.paths {
                slots.push(selection.number(path)?);
            }
        }
        Ok(Self { request: index, selection, slots })
    }
}

/// Why a message cannot be kept.
enum Fault {
    Wrong(Wrong),
    Many,
}

impl From<Wrong> for Fault {
    fn from(wrong: Wrong) -> Self {
        Self::Wrong(wrong)
    }
}

/// What has been gathered for a request, and what was taken from the last message.
#[derive(Debug)]
struct Gathered {
    series: Series,
    taken: Taken,
    paths: usize,
    named: bool,
    only: Option<Vec<String>>,
    /// The names of the last message as they are written, and the number of each one.
    last: (Vec<u8>, Vec<Option<usize>>),
}

impl Gathered {
    fn new(request: &Request) -> Self {
        let paths = request.paths.len();
        let columns = if request.names.is_some() { 0 } else { paths };
        Self {
            series: Series { columns: vec![Vec::new(); columns], ..Series::default() },
            taken: Taken::default(),
            paths,
            named: request.names.is_some(),
            only: request.only.clone(),
            last: (Vec::new(), Vec::new()),
        }
    }

    /// Keeps what was taken; a message that has none of the wanted names gives no row.
    fn keep(&mut self, taker: &Taker, received: i64) -> Result<(), Fault> {
        if self.named && !self.keep_lists()? {
            return Ok(());
        }
        for (column, slot) in self.series.columns.iter_mut().zip(&taker.slots) {
            column.push(self.taken.numbers[*slot]);
        }
        self.series.stamps.extend(taker.selection.stamp(&self.taken));
        self.series.received.push(received);
        Ok(())
    }

    /// One row of elements by name; whether there is any.
    fn keep_lists(&mut self) -> Result<bool, Fault> {
        if self.last.0 != self.taken.names {
            let names = core::mem::take(&mut self.taken.names);
            let numbers = self.number_names(&names)?;
            self.last = (names, numbers);
        }
        if self.last.1.iter().all(Option::is_none) {
            return Ok(false);
        }
        let row = self.series.received.len();
        for column in &mut self.series.columns {
            column.push(f64::NAN);
        }
        for (path, list) in self.taken.lists.iter().enumerate() {
            for (number, value) in self.last.1.iter().zip(list) {
                if let Some(number) = number {
                    self.series.columns[number * self.paths + path][row] = *value;
                }
            }
        }
        Ok(true)
    }

    /// The number of each name; a wanted one that is new gets columns of its own, by name and path.
    fn number_names(&mut self, names: &[u8]) -> Result<Vec<Option<usize>>, Fault> {
        let mut cursor = Cursor::within(names, self.taken.big_endian);
        let mut numbers = Vec::new();
        for _ in 0..self.taken.count {
            let name = String::from_utf8_lossy(cursor.text()?).into_owned();
            if self.only.as_ref().is_some_and(|only| !only.contains(&name)) {
                numbers.push(None);
                continue;
            }
            let known = self.series.names.iter().position(|known| *known == name);
            numbers.push(Some(match known {
                Some(number) => number,
                None => self.add_name(name)?,
            }));
        }
        Ok(numbers)
    }

    fn add_name(&mut self, name: String) -> Result<usize, Fault> {
        if self.series.names.len() == MOST_NAMES {
            return Err(Fault::Many);
        }
        self.series.names.push(name);
        let rows = self.series.received.len();
        self.series.columns.extend((0..self.paths).map(|_| vec![f64::NAN; rows]));
        Ok(self.series.names.len() - 1)
    }

    /// Sorts columns by path, then name.
    fn finish(mut self) -> Series {
        if self.named && self.paths > 0 {
            let mut columns = core::mem::take(&mut self.series.columns);
            let names = self.series.names.len();
            self.series.columns = (0..self.paths)
                .flat_map(|path| (0..names).map(move |name| name * self.paths + path))
                .map(|at| core::mem::take(&mut columns[at]))
                .collect();
        }
        self.series
    }
}
