//! Networks in ONNX Runtime, whose shared library is loaded when the server starts.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};

use ort::environment::Environment;
use ort::session::Session;
use ort::value::{DynValue, TensorElementType, TensorRef, ValueType};

use super::error::SegmentError;
use super::settings::Refused;
use super::tensor::{Output, Runtime, Tensor};

/// The environment variable that names the library if the configuration does not.
const LIBRARY_VARIABLE: &str = "ORT_DYLIB_PATH";

/// A process has one environment, made of the first library that was loaded.
static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();

#[derive(Debug)]
pub(super) struct OnnxRuntime {
    /// Running needs it alone.
    session: Mutex<Session>,
    input: String,
    /// The model's input has a batch dimension.
    is_batched: bool,
}

impl OnnxRuntime {
    /// Loads the library and the model, whose input must take an image of `input_px`, (width, height).
    pub(super) fn open(
        library: Option<&Path>,
        model: &[u8],
        input_px: (u32, u32),
        threads: usize,
    ) -> Result<Self, Refused> {
        let environment = environment(library)?;
        let refused = |error: ort::Error| ("segmenter.model", error.to_string());
        let session = session(environment, model, threads).map_err(refused)?;
        let [input] = session.inputs() else {
            let why = format!("the model has {} inputs, not one", session.inputs().len());
            return Err(("segmenter.model", why));
        };
        let is_batched = is_batched(input.dtype(), input_px)?;
        Ok(Self {
            input: input.name().to_owned(),
            session: Mutex::new(session),
            is_batched,
        })
    }
}

impl Runtime for OnnxRuntime {
    fn run(&self, image: &Tensor) -> Result<Vec<Output>, SegmentError> {
        let failed = |error: ort::Error| SegmentError::Runtime(error.to_string());
        let batch: &[usize] = if self.is_batched { &[1] } else { &[] };
        let shape = [batch, &image.shape].concat();
        let input = TensorRef::from_array_view((shape, &*image.values)).map_err(failed)?;
        let mut session = self.session.lock().expect("no panic while held");
        let outputs = session
            .run(ort::inputs![self.input.as_str() => input])
            .map_err(failed)?;
        let read = |(name, value): (&str, ort::value::ValueRef<'_>)| {
            Ok(Output {
                name: name.to_owned(),
                tensor: tensor(&value).map_err(failed)?,
            })
        };
        outputs.iter().map(read).collect()
    }
}

fn environment(library: Option<&Path>) -> Result<&'static Environment, Refused> {
    if let Some(made) = ENVIRONMENT.get() {
        return Ok(made);
    }
    let (key, path) = match (library, std::env::var_os(LIBRARY_VARIABLE)) {
        (Some(path), _) => ("segmenter.library", path.to_owned()),
        (None, Some(path)) if !path.is_empty() => (LIBRARY_VARIABLE, PathBuf::from(path)),
        _ => ("segmenter.library", system_library()),
    };
    let builder = ort::init_from(&path).map_err(|error| {
        let advice = "name the shared library of ONNX Runtime in segmenter.library";
        (key, format!("{error}; {advice} or {LIBRARY_VARIABLE}"))
    })?;
    let made = builder.with_telemetry(false).build();
    let made = made.map_err(|error| (key, format!("{}: {error}", path.display())))?;
    Ok(ENVIRONMENT.get_or_init(|| made))
}

/// The library's name where the system's loader looks.
fn system_library() -> PathBuf {
    use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
    format!("{DLL_PREFIX}onnxruntime{DLL_SUFFIX}").into()
}

fn session(environment: &Environment, model: &[u8], threads: usize) -> ort::Result<Session> {
    // Threads that wait for the next image leave the processor to others.
    Session::builder(environment)?
        .with_intra_threads(threads)?
        .with_intra_op_spinning(false)?
        .commit_from_memory(model)
}

/// Whether the input is [1, 3, height, width] rather than [3, height, width].
fn is_batched(input: &ValueType, (width, height): (u32, u32)) -> Result<bool, Refused> {
    let ValueType::Tensor { ty, shape, .. } = input else {
        return Err(("segmenter.model", format!("the model's input is {input}")));
    };
    if *ty != TensorElementType::Float32 {
        let why = format!("the model's input is {ty:?}: export it with Float32 input");
        return Err(("segmenter.model", why));
    }
    let wanted = [1, 3, i64::from(height), i64::from(width)];
    let is_batched = shape.len() == 4;
    let wanted = &wanted[usize::from(!is_batched)..];
    // Negative where the model takes any.
    let fits =
        shape.len() == wanted.len() && shape.iter().zip(wanted).all(|(s, w)| s == w || *s < 0);
    if fits {
        return Ok(is_batched);
    }
    let why = format!("the model's input is {shape:?}, an image {wanted:?}");
    Err(("segmenter.input_px", why))
}

fn tensor(value: &DynValue) -> ort::Result<Tensor> {
    let of = |shape: &[i64], values: Vec<f32>| {
        let shape = shape.iter().map(|&length| length as usize).collect();
        Tensor::new(shape, values)
    };
    if let Ok((shape, labels)) = value.try_extract_tensor::<i64>() {
        return Ok(of(
            shape,
            labels.iter().map(|&label| label as f32).collect(),
        ));
    }
    let (shape, values) = value.try_extract_tensor::<f32>()?;
    Ok(of(shape, values.to_vec()))
}
