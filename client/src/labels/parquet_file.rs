//! Flat tables as Parquet.

use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{
    ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type, Int64Type,
};
use parquet::errors::Result;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};

/// The values of a column, one a row.
#[derive(Clone, Debug)]
pub(super) enum Values {
    Int8(Vec<i32>),
    /// Nulls, one a row.
    NoInt8(usize),
    Int32(Vec<i32>),
    Int64(Vec<i64>),
    Float(Vec<Option<f32>>),
    Double(Vec<Option<f64>>),
    Text(Vec<String>),
    Bytes(Vec<bytes::Bytes>),
    /// Row-major 4 x 4 matrices, as lists of 16.
    Matrix(Vec<[f64; 16]>),
}

/// A table of named columns of equal length, as one row group.
///
/// # Errors
/// If a column cannot be encoded.
pub(super) fn encode(columns: &[(String, Values)]) -> Result<Vec<u8>> {
    let fields = columns.iter().map(|(name, values)| field(name, values));
    let fields = fields.collect::<Result<Vec<_>>>()?;
    let schema = Type::group_type_builder("schema")
        .with_fields(fields)
        .build()?;
    let properties = Arc::new(WriterProperties::builder().build());
    let mut file = Vec::new();
    let mut writer = SerializedFileWriter::new(&mut file, Arc::new(schema), properties)?;
    let mut rows = writer.next_row_group()?;
    for (_, values) in columns {
        let column = rows.next_column()?;
        write(column.expect("the schema has as many columns"), values)?;
    }
    rows.close()?;
    writer.close()?;
    Ok(file)
}

fn field(name: &str, values: &Values) -> Result<TypePtr> {
    let (physical, logical, repetition) = match values {
        Values::Int8(_) => (
            Physical::INT32,
            Some(LogicalType::integer(8, true)),
            Repetition::REQUIRED,
        ),
        Values::NoInt8(_) => (
            Physical::INT32,
            Some(LogicalType::integer(8, true)),
            Repetition::OPTIONAL,
        ),
        Values::Int32(_) => (Physical::INT32, None, Repetition::REQUIRED),
        Values::Int64(_) => (Physical::INT64, None, Repetition::REQUIRED),
        Values::Float(_) => (Physical::FLOAT, None, Repetition::OPTIONAL),
        Values::Double(_) => (Physical::DOUBLE, None, Repetition::OPTIONAL),
        Values::Text(_) => (
            Physical::BYTE_ARRAY,
            Some(LogicalType::String),
            Repetition::REQUIRED,
        ),
        Values::Bytes(_) => (Physical::BYTE_ARRAY, None, Repetition::REQUIRED),
        Values::Matrix(_) => return list(name),
    };
    let field = Type::primitive_type_builder(name, physical)
        .with_logical_type(logical)
        .with_repetition(repetition)
        .build()?;
    Ok(Arc::new(field))
}

/// Parquet's three-level list of doubles.
fn list(name: &str) -> Result<TypePtr> {
    let element = Type::primitive_type_builder("element", Physical::DOUBLE)
        .with_repetition(Repetition::REQUIRED)
        .build()?;
    let repeated = Type::group_type_builder("list")
        .with_repetition(Repetition::REPEATED)
        .with_fields(vec![Arc::new(element)])
        .build()?;
    let list = Type::group_type_builder(name)
        .with_repetition(Repetition::REQUIRED)
        .with_logical_type(Some(LogicalType::List))
        .with_fields(vec![Arc::new(repeated)])
        .build()?;
    Ok(Arc::new(list))
}

fn write(column: SerializedColumnWriter<'_>, values: &Values) -> Result<()> {
    match values {
        Values::Int8(values) | Values::Int32(values) => {
            put::<Int32Type>(column, values, None, None)
        }
        Values::Int64(values) => put::<Int64Type>(column, values, None, None),
        Values::NoInt8(rows) => put::<Int32Type>(column, &[], Some(&vec![0; *rows]), None),
        Values::Float(values) => put_present::<FloatType>(column, values),
        Values::Double(values) => put_present::<DoubleType>(column, values),
        Values::Text(values) => {
            let values: Vec<ByteArray> = values.iter().map(|v| v.as_str().into()).collect();
            put::<ByteArrayType>(column, &values, None, None)
        }
        Values::Bytes(values) => {
            let values: Vec<ByteArray> = values.iter().cloned().map(ByteArray::from).collect();
            put::<ByteArrayType>(column, &values, None, None)
        }
        Values::Matrix(values) => {
            let flat = values.as_flattened();
            let defined = vec![1; flat.len()];
            let repeated: Vec<i16> = (0..flat.len()).map(|i| i16::from(i % 16 != 0)).collect();
            put::<DoubleType>(column, flat, Some(&defined), Some(&repeated))
        }
    }
}

fn put_present<T: DataType>(
    column: SerializedColumnWriter<'_>,
    values: &[Option<T::T>],
) -> Result<()> {
    let present: Vec<T::T> = values.iter().flatten().cloned().collect();
    let defined: Vec<i16> = values.iter().map(|v| i16::from(v.is_some())).collect();
    put::<T>(column, &present, Some(&defined), None)
}

fn put<T: DataType>(
    mut column: SerializedColumnWriter<'_>,
    values: &[T::T],
    defined: Option<&[i16]>,
    repeated: Option<&[i16]>,
) -> Result<()> {
    column.typed::<T>().write_batch(values, defined, repeated)?;
    column.close()
}

#[cfg(test)]
mod tests {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;

    use super::*;

    #[test]
    fn every_kind_of_column_reads_back() {
        let matrix: [f64; 16] = std::array::from_fn(|i| i as f64);
        let other: [f64; 16] = std::array::from_fn(|i| -(i as f64));
        let columns = [
            ("key.camera_name", Values::Int8(vec![1, -2])),
            ("[A].none", Values::NoInt8(2)),
            ("[A].width", Values::Int32(vec![1242, 375])),
            (
                "key.frame_timestamp_micros",
                Values::Int64(vec![1 << 40, 7]),
            ),
            ("[A].speed.x", Values::Float(vec![None, Some(0.5)])),
            ("[A].box.center.x", Values::Double(vec![Some(1.25), None])),
            ("key.id", Values::Text(vec!["a".into(), "bc".into()])),
            (
                "[A].image",
                Values::Bytes(vec![vec![1, 0, 2].into(), vec![].into()]),
            ),
            ("[A].pose.transform", Values::Matrix(vec![matrix, other])),
        ];
        let columns = columns.map(|(name, values)| (name.to_owned(), values));
        let file = encode(&columns).unwrap();
        let reader = SerializedFileReader::new(bytes::Bytes::from(file)).unwrap();
        let rows: Vec<_> = reader
            .get_row_iter(None)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(rows.len(), 2);
        for (i, row) in rows.iter().enumerate() {
            let names: Vec<&String> = row.get_column_iter().map(|(name, _)| name).collect();
            assert!(
                names
                    .iter()
                    .zip(&columns)
                    .all(|(read, (name, _))| *read == name)
            );
            assert_eq!(row.get_byte(0).unwrap(), [1, -2][i]);
            assert!(row.get_byte(1).is_err(), "it is null");
            assert_eq!(row.get_int(2).unwrap(), [1242, 375][i]);
            assert_eq!(row.get_long(3).unwrap(), [1 << 40, 7][i]);
            assert_eq!(row.get_float(4).ok(), [None, Some(0.5)][i]);
            assert_eq!(row.get_double(5).ok(), [Some(1.25), None][i]);
            assert_eq!(row.get_string(6).unwrap(), ["a", "bc"][i]);
            let bytes: [&[u8]; 2] = [&[1, 0, 2], &[]];
            assert_eq!(row.get_bytes(7).unwrap().data(), bytes[i]);
            let list = row.get_list(8).unwrap().elements().len();
            assert_eq!(list, 16);
        }
    }

    #[test]
    fn an_empty_table_is_a_file_with_its_columns() {
        let columns = [("key.id".to_owned(), Values::Text(Vec::new()))];
        let file = encode(&columns).unwrap();
        let reader = SerializedFileReader::new(bytes::Bytes::from(file)).unwrap();
        assert_eq!(reader.metadata().file_metadata().num_rows(), 0);
        assert_eq!(
            reader
                .metadata()
                .file_metadata()
                .schema_descr()
                .num_columns(),
            1
        );
    }
}
