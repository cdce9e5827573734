//! One component of a segment: a Parquet file, read row by row.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::Bytes;
use parquet::basic::Type as PhysicalType;
use parquet::column::reader::{ColumnReaderImpl, get_column_reader, get_typed_column_reader};
use parquet::data_type::{ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::schema::types::ColumnDescPtr;

use super::pages::{self, BudgetedPages, MAX_ROW_VALUES};
use crate::read_log::contained::contained;
use crate::read_log::{Error, Result};

/// Rows of one file: the boxes of a segment are tens of thousands.
const MAX_ROWS: i64 = 10_000_000;

/// An open component.
pub(super) struct Table {
    path: PathBuf,
    file: File,
    reader: SerializedFileReader<File>,
}

impl Table {
    /// Opens the component; `None` if the file is not there.
    pub(super) fn open(root: &Path, component: &str, segment: &str) -> Result<Option<Self>> {
        let path = component_path(root, component, segment);
        if !path.exists() {
            return Ok(None);
        }
        let io = |e| Error::io(&path, e, "");
        let file = File::open(&path).map_err(io)?;
        let clone = file.try_clone().map_err(io)?;
        let reader = contained(|| SerializedFileReader::new(clone).map_err(|e| e.to_string()));
        let reader = reader.map_err(|e| {
            let what =
                format!("is no complete Parquet file: it is cut off or something else ({e})");
            Error::malformed(&path, what)
        })?;
        let rows = reader.metadata().file_metadata().num_rows();
        if !(0..=MAX_ROWS).contains(&rows) {
            let what = format!("says it has {rows} rows, at most {MAX_ROWS} are accepted");
            return Err(Error::malformed(&path, what));
        }
        Ok(Some(Self { path, file, reader }))
    }

    /// Opens a component that a log cannot do without.
    pub(super) fn required(root: &Path, component: &str, segment: &str) -> Result<Self> {
        Self::open(root, component, segment)?.ok_or_else(|| Error::Missing {
            path: component_path(root, component, segment),
            hint: "a segment needs camera_image, camera_calibration and vehicle_pose".to_owned(),
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Its rows with the given columns; those of `optional` may be absent.
    pub(super) fn rows<'t>(&'t self, names: &'t [&'t str], optional: &[&str]) -> Result<Rows<'t>> {
        let schema = self.reader.metadata().file_metadata().schema_descr_ptr();
        let mut indices = Vec::with_capacity(names.len());
        for name in names {
            let index =
                (0..schema.num_columns()).find(|&i| schema.get_column_root(i).name() == *name);
            if index.is_none() && !optional.contains(name) {
                let what = format!("has no column {name}");
                return Err(Error::malformed(&self.path, what));
            }
            indices.push(index);
        }
        Ok(Rows {
            table: self,
            names,
            indices,
            columns: Vec::new(),
            group: 0,
            left_in_group: 0,
            row: 0,
        })
    }
}

fn component_path(root: &Path, component: &str, segment: &str) -> PathBuf {
    root.join(component).join(format!("{segment}.parquet"))
}

/// A cursor over the rows of a table.
pub(super) struct Rows<'t> {
    table: &'t Table,
    names: &'t [&'t str],
    indices: Vec<Option<usize>>,
    columns: Vec<Option<Column>>,
    group: usize,
    left_in_group: i64,
    row: usize,
}

impl<'t> Rows<'t> {
    /// The next row; `None` at the end.
    pub(super) fn next_row(&mut self) -> Result<Option<Row<'t>>> {
        contained(|| self.advance()).map_err(|what| Error::malformed(&self.table.path, what))
    }

    fn advance(&mut self) -> Result<Option<Row<'t>>, String> {
        while self.left_in_group == 0 {
            if self.group == self.table.reader.num_row_groups() {
                return Ok(None);
            }
            self.open_group()?;
        }
        self.left_in_group -= 1;
        self.row += 1;
        let mut cells = Vec::with_capacity(self.columns.len());
        for (column, name) in self.columns.iter_mut().zip(self.names) {
            let cell = match column {
                Some(column) => column.next_cell(),
                None => Ok(Cell::Absent),
            };
            cells.push(cell.map_err(|what| format!("row {}: {name} {what}", self.row - 1))?);
        }
        Ok(Some(Row {
            path: &self.table.path,
            names: self.names,
            cells,
            row: self.row - 1,
        }))
    }

    fn open_group(&mut self) -> Result<(), String> {
        let group = self
            .table
            .reader
            .get_row_group(self.group)
            .map_err(|e| e.to_string())?;
        self.left_in_group = group.metadata().num_rows();
        if !(0..=MAX_ROWS).contains(&self.left_in_group) {
            return Err(format!("says a group has {} rows", self.left_in_group));
        }
        self.columns.clear();
        for (index, name) in self.indices.iter().zip(self.names) {
            let Some(index) = *index else {
                self.columns.push(None);
                continue;
            };
            let in_column = |what: String| format!("column {name} {what}");
            pages::check(&self.table.file, group.metadata().column(index)).map_err(in_column)?;
            let inner = group
                .get_column_page_reader(index)
                .map_err(|e| in_column(e.to_string()))?;
            let descriptor = self
                .table
                .reader
                .metadata()
                .file_metadata()
                .schema_descr_ptr()
                .column(index);
            self.columns
                .push(Some(Column::new(descriptor, inner).map_err(in_column)?));
        }
        self.group += 1;
        Ok(())
    }
}

/// A column of any type that the data set uses.
enum Column {
    Float(TypedColumn<FloatType>),
    Double(TypedColumn<DoubleType>),
    Int32(TypedColumn<Int32Type>),
    Int64(TypedColumn<Int64Type>),
    Bytes(TypedColumn<ByteArrayType>),
}

impl Column {
    fn new(
        descriptor: ColumnDescPtr,
        pages: Box<dyn parquet::column::page::PageReader>,
    ) -> Result<Self, String> {
        Ok(match descriptor.physical_type() {
            PhysicalType::FLOAT => Self::Float(TypedColumn::new(descriptor, pages)),
            PhysicalType::DOUBLE => Self::Double(TypedColumn::new(descriptor, pages)),
            PhysicalType::INT32 => Self::Int32(TypedColumn::new(descriptor, pages)),
            PhysicalType::INT64 => Self::Int64(TypedColumn::new(descriptor, pages)),
            PhysicalType::BYTE_ARRAY => Self::Bytes(TypedColumn::new(descriptor, pages)),
            other => return Err(format!("is of type {other}, which no component has")),
        })
    }

    fn next_cell(&mut self) -> Result<Cell, String> {
        let numbers = match self {
            Self::Float(column) => column
                .next_values()?
                .iter()
                .map(|&v| f64::from(v))
                .collect(),
            Self::Double(column) => column.next_values()?.to_vec(),
            Self::Int32(column) => column
                .next_values()?
                .iter()
                .map(|&v| f64::from(v))
                .collect(),
            // Times in microseconds have 51 bits.
            Self::Int64(column) => column.next_values()?.iter().map(|&v| v as f64).collect(),
            Self::Bytes(column) => {
                let values = column.next_values()?;
                return Ok(Cell::Bytes(
                    values.first().map(|v| Bytes::copy_from_slice(v.data())),
                ));
            }
        };
        Ok(Cell::Numbers(numbers))
    }
}

/// Reads the values of a row at a time.
struct TypedColumn<T: DataType> {
    reader: ColumnReaderImpl<T>,
    budget: Arc<AtomicU64>,
    definition_levels: Vec<i16>,
    repetition_levels: Vec<i16>,
    values: Vec<T::T>,
}

impl<T: DataType> TypedColumn<T> {
    fn new(descriptor: ColumnDescPtr, inner: Box<dyn parquet::column::page::PageReader>) -> Self {
        let budget = Arc::new(AtomicU64::new(0));
        let pages = BudgetedPages {
            inner,
            budget: Arc::clone(&budget),
        };
        Self {
            reader: get_typed_column_reader(get_column_reader(descriptor, Box::new(pages))),
            budget,
            definition_levels: Vec::new(),
            repetition_levels: Vec::new(),
            values: Vec::new(),
        }
    }

    /// The values of the next row; none for a missing one.
    fn next_values(&mut self) -> Result<&[T::T], String> {
        self.budget.store(MAX_ROW_VALUES, Ordering::Relaxed);
        self.definition_levels.clear();
        self.repetition_levels.clear();
        self.values.clear();
        let (records, _, _) = self
            .reader
            .read_records(
                1,
                Some(&mut self.definition_levels),
                Some(&mut self.repetition_levels),
                &mut self.values,
            )
            .map_err(|e| format!("does not decode: {e}"))?;
        if records == 1 {
            Ok(&self.values)
        } else {
            Err("ends before its table does".to_owned())
        }
    }
}

/// The content of a column in a row.
enum Cell {
    Numbers(Vec<f64>),
    Bytes(Option<Bytes>),
    /// The file has no such column.
    Absent,
}

/// One row.
pub(super) struct Row<'t> {
    path: &'t Path,
    names: &'t [&'t str],
    cells: Vec<Cell>,
    row: usize,
}

impl Row<'_> {
    /// An error about this row.
    pub(super) fn bad(&self, what: impl std::fmt::Display) -> Error {
        Error::malformed(self.path, format!("row {}: {what}", self.row))
    }

    /// All numbers of a column; none if it is missing.
    pub(super) fn numbers(&self, name: &str) -> Result<&[f64]> {
        match self.cell(name) {
            Cell::Numbers(numbers) => Ok(numbers),
            Cell::Absent => Ok(&[]),
            Cell::Bytes(_) => Err(self.bad(format!("{name} is not a number"))),
        }
    }

    /// Exactly `N` numbers.
    pub(super) fn array<const N: usize>(&self, name: &str) -> Result<[f64; N]> {
        let numbers = self.numbers(name)?;
        numbers.try_into().map_err(|_| {
            let count = numbers.len();
            self.bad(format!("{name} has {count} numbers, {N} are needed"))
        })
    }

    pub(super) fn number(&self, name: &str) -> Result<f64> {
        Ok(self.array::<1>(name)?[0])
    }

    pub(super) fn integer(&self, name: &str) -> Result<i64> {
        let number = self.number(name)?;
        // Larger ones are not exact here, and in no component.
        if number.fract() == 0.0 && number.abs() < 9e15 {
            Ok(number as i64)
        } else {
            Err(self.bad(format!("{name} is {number}, not an integer")))
        }
    }

    pub(super) fn bytes(&self, name: &str) -> Result<&Bytes> {
        match self.cell(name) {
            Cell::Bytes(Some(bytes)) => Ok(bytes),
            Cell::Bytes(None) | Cell::Absent => Err(self.bad(format!("{name} is missing"))),
            Cell::Numbers(_) => Err(self.bad(format!("{name} is a number, not bytes"))),
        }
    }

    pub(super) fn text(&self, name: &str) -> Result<String> {
        let text = String::from_utf8(self.bytes(name)?.to_vec());
        text.map_err(|_| self.bad(format!("{name} is not text")))
    }

    fn cell(&self, name: &str) -> &Cell {
        let at = self.names.iter().position(|n| *n == name);
        &self.cells[at.expect("only columns that were asked for are read")]
    }
}
