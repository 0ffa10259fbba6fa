//! Numbers out of ROS bags.
//!
//! A bag holds messages of topics, serialised as CDR (OMG, *Common Data Representation*, classic form), with the text of
//! their definitions beside them. A [`Collector`] knows which fields of which topics are wanted; it compiles a
//! definition into what is to be taken from each message, and gathers columns. An [`McapReader`] feeds it from an MCAP
//! file; rows of any other storage are [added](Collector::add) as they come.
//!
//! Whatever a file holds, nothing panics, and memory stays in proportion to what was read.

mod cdr;
mod collect;
mod definition;
mod error;
mod known;
mod mcap;
mod selection;
mod unpack;

pub use collect::{Collector, Request, Series, Topic, Written};
pub use error::BagError;
pub use mcap::McapReader;
pub use unpack::unpack_file;
