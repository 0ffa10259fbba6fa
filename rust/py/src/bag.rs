//! Bags: numbers of messages, as columns.

use crate::error::LogError;
use crate::gil::Release;
use linkside_bag::{BagError, Collector, Request, Written};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyList;
use std::fs::File;
use std::io::BufReader;
use std::path::PathBuf;

/// A topic, paths, the path of names and the names wanted, as Python has them.
type Wanted = (String, Vec<String>, Option<String>, Option<Vec<String>>);

/// Stamps, times of recording, names and columns of a request.
type Found<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<i64>>, Vec<String>, Bound<'py, PyList>);

/// Gathers columns from messages.
#[pyclass(module = "linkside._core")]
pub(crate) struct BagCollector {
    collector: Option<Collector>,
}

#[pymethods]
impl BagCollector {
    #[new]
    fn new(requests: Vec<Wanted>, compressed: bool) -> Self {
        let request = |(topic, paths, names, only)| Request { topic, paths, names, only };
        Self { collector: Some(Collector::new(requests.into_iter().map(request).collect(), compressed)) }
    }

    fn define(
        &mut self,
        topic: &str,
        message: &str,
        encoding: &str,
        language: &str,
        definition: &[u8],
        py: Python<'_>,
    ) -> PyResult<usize> {
        let collector = self.open()?;
        py.release_briefly(|| collector.define(topic, Written { message, encoding, language, definition }))
    }

    fn add(&mut self, channel: usize, rows: Vec<(i64, PyBackedBytes)>, py: Python<'_>) -> PyResult<()> {
        let collector = self.open()?;
        py.release_briefly(|| rows.iter().try_for_each(|(received, data)| collector.add(channel, *received, data)))
    }

    fn topics(&mut self) -> PyResult<Vec<(String, String, u64)>> {
        let topics = self.open()?.topics();
        Ok(topics.iter().map(|topic| (topic.name.clone(), topic.message.clone(), topic.count)).collect())
    }

    fn finish<'py>(&mut self, py: Python<'py>) -> PyResult<Vec<Found<'py>>> {
        self.open()?;
        let series = self.collector.take().map(Collector::finish).unwrap_or_default();
        series
            .into_iter()
            .map(|found| {
                let columns = PyList::new(py, found.columns.into_iter().map(|column| PyArray1::from_vec(py, column)))?;
                let (stamps, received) = (PyArray1::from_vec(py, found.stamps), PyArray1::from_vec(py, found.received));
                Ok((stamps, received, found.names, columns))
            })
            .collect()
    }
}

impl BagCollector {
    fn open(&mut self) -> PyResult<&mut Collector> {
        self.collector.as_mut().ok_or_else(|| LogError::new_err("this collector is finished"))
    }
}

/// Reads an MCAP file from its beginning to its end.
#[pyclass(module = "linkside._core")]
pub(crate) struct McapReader {
    reader: linkside_bag::McapReader<BufReader<File>>,
}

#[pymethods]
impl McapReader {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        let file = BufReader::with_capacity(1 << 20, File::open(path)?);
        let reader = linkside_bag::McapReader::new(file).map_err(crate::error::IntoPyErr::into_py_err)?;
        Ok(Self { reader })
    }

    fn advance(&mut self, collector: &mut BagCollector, py: Python<'_>) -> PyResult<bool> {
        let (reader, collector) = (&mut self.reader, collector.open()?);
        py.release_briefly(|| reader.advance(collector))
    }

    #[getter]
    fn truncated(&self) -> bool {
        self.reader.truncated()
    }

    #[getter]
    fn damaged(&self) -> Vec<u64> {
        self.reader.damaged().to_vec()
    }
}

/// Unpacks a file that is compressed with zstd.
#[pyfunction]
pub(crate) fn unpack_file(source: PathBuf, target: PathBuf, py: Python<'_>) -> PyResult<()> {
    py.release_briefly(|| -> Result<(), BagError> { linkside_bag::unpack_file(&source, &target) })
}
