//! Networks in tract, which is Rust alone: slower, and without some operators of large models.

use std::io::Cursor;
use std::sync::Arc;

use tract_onnx::prelude::{
    DatumType, Framework, InferenceFact, InferenceModel, InferenceModelExt, IntoRunnable, TValue,
    TVec, Tensor as TractTensor, TractResult, TypedRunnableModel, tvec,
};

use super::error::SegmentError;
use super::settings::Refused;
use super::tensor::{Output, Runtime, Tensor};

#[derive(Debug)]
pub(super) struct Tract {
    plan: Arc<TypedRunnableModel>,
    /// Of the outputs.
    names: Vec<String>,
    /// The model's input has a batch dimension.
    is_batched: bool,
}

impl Tract {
    /// Reads the model and optimises it for an image of `input_px`, (width, height).
    pub(super) fn open(model: &[u8], input_px: (u32, u32)) -> Result<Self, Refused> {
        let refused = |error| ("segmenter.model", format!("{error:#}"));
        let read = tract_onnx::onnx().model_for_read(&mut Cursor::new(model));
        let read = read.map_err(refused)?;
        let is_batched = is_batched(&read)?;
        let names = names(&read).map_err(refused)?;
        let (width, height) = (input_px.0 as usize, input_px.1 as usize);
        let batch: &[usize] = if is_batched { &[1] } else { &[] };
        let shape = [batch, &[3, height, width]].concat();
        let input = InferenceFact::dt_shape(DatumType::F32, shape.clone());
        let fixed = require_shape(&read, &shape).and_then(|()| {
            let fixed = read.with_input_fact(0, input);
            fixed.map_err(|error| ("segmenter.model", format!("{error:#}")))
        })?;
        let optimise = || fixed.into_optimized()?.into_runnable();
        Ok(Self {
            plan: optimise().map_err(refused)?,
            names,
            is_batched,
        })
    }
}

impl Runtime for Tract {
    fn run(&self, image: &Tensor) -> Result<Vec<Output>, SegmentError> {
        let run = || -> TractResult<Vec<Output>> {
            let batch: &[usize] = if self.is_batched { &[1] } else { &[] };
            let shape = [batch, &image.shape].concat();
            let input = TractTensor::from_shape(&shape, &image.values)?;
            let outputs: TVec<TValue> = self.plan.run(tvec!(input.into()))?;
            let read = |(name, value): (&String, &TValue)| {
                let converted = value.cast_to::<f32>()?;
                let values = converted.try_as_plain_ram()?.as_slice::<f32>()?.to_vec();
                Ok(Output {
                    name: name.clone(),
                    tensor: Tensor::new(converted.shape().to_vec(), values),
                })
            };
            self.names.iter().zip(&outputs).map(read).collect()
        };
        run().map_err(|error| SegmentError::Runtime(format!("{error:#}")))
    }
}

/// Whether the input is [1, 3, height, width] rather than [3, height, width]. One whose shape is not written is taken for the former.
fn is_batched(model: &InferenceModel) -> Result<bool, Refused> {
    let refused = |error| ("segmenter.model", format!("{error:#}"));
    let count = model.input_outlets().map_err(refused)?.len();
    if count != 1 {
        let why = format!("the model has {count} inputs, not one");
        return Err(("segmenter.model", why));
    }
    let fact = model.input_fact(0).map_err(refused)?;
    Ok(fact.shape.dims().count() != 3)
}

/// Whether the input as written takes `wanted`, and f32.
fn require_shape(model: &InferenceModel, wanted: &[usize]) -> Result<(), Refused> {
    use tract_onnx::tract_hir::infer::Factoid;
    let fact = model.input_fact(0);
    let fact = fact.map_err(|error| ("segmenter.model", format!("{error:#}")))?;
    if let Some(written) = fact
        .datum_type
        .concretize()
        .filter(|t| *t != DatumType::F32)
    {
        let why = format!("the model's input is {written:?}: export it with Float32 input");
        return Err(("segmenter.model", why));
    }
    let written: Vec<Option<i64>> = fact
        .shape
        .dims()
        .map(|dim| dim.concretize().and_then(|d| d.to_i64().ok()))
        .collect();
    let length_fits = written.len() == wanted.len() || fact.shape.is_open();
    let mut pairs = written.iter().zip(wanted);
    if length_fits && pairs.all(|(written, &wanted)| written.is_none_or(|w| w == wanted as i64)) {
        return Ok(());
    }
    let why = format!(
        "the model's input is {}, an image {wanted:?}",
        shape_text(&written)
    );
    Err(("segmenter.input_px", why))
}

fn shape_text(shape: &[Option<i64>]) -> String {
    let one = |d: &Option<i64>| d.map_or("any".to_owned(), |d| d.to_string());
    let all: Vec<String> = shape.iter().map(one).collect();
    format!("[{}]", all.join(", "))
}

fn names(model: &InferenceModel) -> TractResult<Vec<String>> {
    let outlets = model.output_outlets()?.iter();
    let name = |outlet: &tract_onnx::prelude::OutletId| {
        let label = model.outlet_label(*outlet);
        label.unwrap_or(&model.node(outlet.node).name).to_owned()
    };
    Ok(outlets.map(name).collect())
}
