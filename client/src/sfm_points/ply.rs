//! Points from PLY, as text or little-endian binary: x, y and z of its vertices, which come first.

use std::path::Path;

use glam::DVec3;

use super::{MOST_POINTS, point, require_room};
use crate::read_log::{Error, Result};

/// Longer headers are no headers.
const MOST_HEADER_LINES: usize = 200;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Text,
    LittleEndian,
}

/// A number of a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Property {
    bytes: usize,
    /// `None` for whole numbers.
    float: Option<Float>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Float {
    Single,
    Double,
}

#[derive(Debug)]
struct Header {
    form: Form,
    vertices: usize,
    properties: Vec<Property>,
    /// Positions of x, y and z among the properties.
    axes: [usize; 3],
    lines: usize,
}

pub(super) fn read(path: &Path, content: &[u8]) -> Result<Vec<DVec3>> {
    let (header, body) = read_header(path, content)?;
    if header.vertices > MOST_POINTS {
        require_room(path, header.vertices)?;
    }
    match header.form {
        Form::Text => read_text(path, &header, body),
        Form::LittleEndian => read_binary(path, &header, body),
    }
}

fn read_text(path: &Path, header: &Header, body: &[u8]) -> Result<Vec<DVec3>> {
    let text = super::text(path, body)?;
    let mut points = Vec::new();
    for (number, line) in (header.lines + 1..).zip(text.lines()).take(header.vertices) {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let numbers = header.axes.map(|axis| fields.get(axis).copied());
        points.push(point(numbers).map_err(|what| Error::at_line(path, number, what))?);
    }
    require_all(path, header, points)
}

fn read_binary(path: &Path, header: &Header, body: &[u8]) -> Result<Vec<DVec3>> {
    let starts: Vec<usize> = header
        .properties
        .iter()
        .scan(0, |end, property| {
            let start = *end;
            *end += property.bytes;
            Some(start)
        })
        .collect();
    let bytes: usize = header.properties.iter().map(|p| p.bytes).sum();
    let vertices = body.chunks_exact(bytes).take(header.vertices);
    let mut points = Vec::new();
    for (number, vertex) in vertices.enumerate() {
        let value = |axis: usize| {
            let at = &vertex[starts[axis]..];
            match header.properties[axis].float {
                Some(Float::Double) => f64::from_le_bytes(first(at)),
                _ => f64::from(f32::from_le_bytes(first(at))),
            }
        };
        let point = DVec3::from_array(header.axes.map(value));
        if !point.is_finite() {
            let what = format!("vertex {number} is {point}, not finite");
            return Err(Error::malformed(path, what));
        }
        points.push(point);
    }
    require_all(path, header, points)
}

/// The first bytes of a slice that is long enough.
fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes[..N].try_into().expect("a slice of its length")
}

fn require_all(path: &Path, header: &Header, points: Vec<DVec3>) -> Result<Vec<DVec3>> {
    if points.len() == header.vertices {
        return Ok(points);
    }
    let what = format!(
        "it ends after {} of the {} vertices of its header",
        points.len(),
        header.vertices
    );
    Err(Error::malformed(path, what))
}

fn read_header<'a>(path: &Path, content: &'a [u8]) -> Result<(Header, &'a [u8])> {
    let mut rest = content;
    let mut lines: Vec<&str> = Vec::new();
    while lines.last() != Some(&"end_header") {
        let line = rest.iter().position(|&byte| byte == b'\n');
        let line = line.filter(|_| lines.len() < MOST_HEADER_LINES);
        let Some(end) = line else {
            return Err(Error::malformed(path, "it has no PLY header"));
        };
        lines.push(super::text(path, &rest[..end])?.trim_end());
        rest = &rest[end + 1..];
    }
    let header = parse(&lines).map_err(|(line, what)| Error::at_line(path, line, what))?;
    Ok((header, rest))
}

/// The error comes with its line.
fn parse(lines: &[&str]) -> Result<Header, (usize, String)> {
    let (mut form, mut vertices) = (None, None);
    let mut names: Vec<&str> = Vec::new();
    let mut properties = Vec::new();
    let mut in_vertex = false;
    if lines.first() != Some(&"ply") {
        return Err((1, "a PLY file begins with \"ply\"".to_owned()));
    }
    for (number, line) in (1..).zip(lines) {
        let bad = |what: String| (number, what);
        match &line.split_whitespace().collect::<Vec<_>>()[..] {
            ["format", "ascii", _] => form = Some(Form::Text),
            ["format", "binary_little_endian", _] => form = Some(Form::LittleEndian),
            ["format", other, ..] => {
                let what = format!("format {other}: ascii and binary_little_endian are read");
                return Err(bad(what));
            }
            ["element", "vertex", count] => {
                let parsed = count.parse::<usize>();
                let parsed = parsed.map_err(|_| bad(format!("{count} vertices")))?;
                vertices = Some(parsed);
                in_vertex = true;
            }
            ["element", name, ..] if vertices.is_none() => {
                return Err(bad(format!("element {name} comes before the vertices")));
            }
            ["element", ..] => in_vertex = false,
            ["property", "list", ..] if in_vertex => {
                return Err(bad("a vertex holds a list, which is not read".to_owned()));
            }
            ["property", kind, name] if in_vertex => {
                properties.push(property(kind).ok_or_else(|| bad(format!("type {kind}")))?);
                names.push(name);
            }
            _ => {}
        }
    }
    let last = lines.len();
    let axis = |name: &str| {
        let found = names.iter().position(|n| *n == name);
        let found = found.filter(|&i| properties[i].float.is_some());
        found.ok_or_else(|| {
            (
                last,
                format!("vertices have no {name} of type float or double"),
            )
        })
    };
    Ok(Header {
        form: form.ok_or_else(|| (last, "the header names no format".to_owned()))?,
        vertices: vertices.ok_or_else(|| (last, "the header names no vertices".to_owned()))?,
        axes: [axis("x")?, axis("y")?, axis("z")?],
        lines: last,
        properties,
    })
}

fn property(kind: &str) -> Option<Property> {
    let (bytes, float) = match kind {
        "char" | "uchar" | "int8" | "uint8" => (1, None),
        "short" | "ushort" | "int16" | "uint16" => (2, None),
        "int" | "uint" | "int32" | "uint32" => (4, None),
        "float" | "float32" => (4, Some(Float::Single)),
        "double" | "float64" => (8, Some(Float::Double)),
        _ => return None,
    };
    Some(Property { bytes, float })
}
