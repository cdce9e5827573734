//! What goes into a network and comes out of it.

use std::fmt::Debug;

use super::error::SegmentError;

/// An array of f32, row-major.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tensor {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

impl Tensor {
    /// # Panics
    /// If the values do not fill the shape.
    pub(super) fn new(shape: Vec<usize>, values: Vec<f32>) -> Self {
        let count: usize = shape.iter().product();
        assert_eq!(count, values.len(), "a tensor of shape {shape:?}");
        Self { shape, values }
    }

    /// # Errors
    /// [`SegmentError::NotFinite`] if a value is; `what` names the values.
    pub(super) fn require_finite(&self, what: &'static str) -> Result<(), SegmentError> {
        if self.values.iter().all(|v| v.is_finite()) {
            return Ok(());
        }
        Err(SegmentError::NotFinite { what })
    }
}

/// A tensor under its name in the model; integers are converted.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Output {
    pub name: String,
    pub tensor: Tensor,
}

/// Shapes for people: "output0 [1, 116, 8400], output1 [1, 32, 160, 160]".
pub(super) fn describe(outputs: &[Output]) -> String {
    let one = |o: &Output| format!("{} {:?}", o.name, o.tensor.shape);
    let all: Vec<String> = outputs.iter().map(one).collect();
    if all.is_empty() {
        "none".to_owned()
    } else {
        all.join(", ")
    }
}

/// Runs a network whose one input is an image.
pub(super) trait Runtime: Debug + Send + Sync {
    /// `image` is RGB or BGR planes, [3, height, width]; runtimes put the batch of one before it where the model has it.
    fn run(&self, image: &Tensor) -> Result<Vec<Output>, SegmentError>;
}
