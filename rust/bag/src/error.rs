//! What can be wrong with a bag, or with what is asked of it.

use thiserror::Error;

/// A bag that cannot be read, or that does not hold what was asked for.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum BagError {
    /// The system could not read or write.
    #[error("cannot be read: {0}")]
    Io(String),
    /// Not an MCAP file.
    #[error("this is not an MCAP file{0}")]
    NotMcap(&'static str),
    /// A record that contradicts itself.
    #[error("the record at byte {at} is damaged: {what}")]
    Record {
        /// Where it begins.
        at: u64,
        /// What is wrong.
        what: String,
    },
    /// A message definition that cannot be understood.
    #[error("definition of {message}: {what}")]
    Definition {
        /// Type of the message.
        message: String,
        /// What is wrong.
        what: String,
    },
    /// A topic that is written in a way that is not known here.
    #[error("topic '{topic}' is written as {found}: {expected} is expected")]
    Encoding {
        /// The topic.
        topic: String,
        /// How it is written.
        found: String,
        /// What can be read.
        expected: &'static str,
    },
    /// A field that is not there, or holds no number.
    #[error("topic '{topic}' ({message}): {what}")]
    Field {
        /// The topic.
        topic: String,
        /// Its type.
        message: String,
        /// What is wrong.
        what: String,
    },
    /// A message that is not what its definition says.
    #[error("topic '{topic}': message {index} {what}")]
    Message {
        /// The topic.
        topic: String,
        /// Which of its messages, from 0.
        index: u64,
        /// What is wrong.
        what: &'static str,
    },
    /// More of something than any recording has.
    #[error("topic '{topic}' has more than {limit} {what}")]
    Many {
        /// The topic.
        topic: String,
        /// The most that is read.
        limit: usize,
        /// Of what.
        what: &'static str,
    },
}

impl From<std::io::Error> for BagError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error.to_string())
    }
}
