//! Writes ONNX files: as much of the format as a small network needs.
//!
//! Field numbers are those of onnx.proto3; the messages leave out what is not written here.

use prost::Message;

const FLOAT: i32 = 1;
const INT64: i32 = 7;
/// Operators as of ONNX 1.8: reductions take their axes as attributes.
const OPERATOR_SET: i64 = 13;
const FORMAT: i64 = 7;

#[derive(Clone, PartialEq, Message)]
struct ModelProto {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(message, optional, tag = "7")]
    graph: Option<GraphProto>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<OperatorSet>,
}

#[derive(Clone, PartialEq, Message)]
struct OperatorSet {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
struct GraphProto {
    #[prost(message, repeated, tag = "1")]
    node: Vec<NodeProto>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializer: Vec<TensorProto>,
    #[prost(message, repeated, tag = "11")]
    input: Vec<ValueInfo>,
    #[prost(message, repeated, tag = "12")]
    output: Vec<ValueInfo>,
}

#[derive(Clone, PartialEq, Message)]
struct NodeProto {
    #[prost(string, repeated, tag = "1")]
    input: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    output: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
    #[prost(message, repeated, tag = "5")]
    attribute: Vec<Attribute>,
}

#[derive(Clone, PartialEq, Message)]
struct Attribute {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(int64, tag = "3")]
    i: i64,
    #[prost(int64, repeated, tag = "8")]
    ints: Vec<i64>,
    #[prost(int32, tag = "20")]
    r#type: i32,
}

#[derive(Clone, PartialEq, Message)]
struct TensorProto {
    #[prost(int64, repeated, tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(float, repeated, tag = "4")]
    float_data: Vec<f32>,
    #[prost(int64, repeated, tag = "7")]
    int64_data: Vec<i64>,
    #[prost(string, tag = "8")]
    name: String,
}

#[derive(Clone, PartialEq, Message)]
struct ValueInfo {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    r#type: Option<TypeProto>,
}

#[derive(Clone, PartialEq, Message)]
struct TypeProto {
    #[prost(message, optional, tag = "1")]
    tensor_type: Option<TensorType>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(int32, tag = "1")]
    elem_type: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    dim: Vec<Dimension>,
}

#[derive(Clone, PartialEq, Message)]
struct Dimension {
    #[prost(int64, tag = "1")]
    dim_value: i64,
}

/// What an operator is told besides its inputs.
#[derive(Clone, Copy, Debug)]
pub enum Setting<'a> {
    Int(i64),
    Ints(&'a [i64]),
}

/// A network that grows operator by operator. Values go by their names.
#[derive(Debug, Default)]
pub struct Network {
    graph: GraphProto,
}

impl Network {
    /// A network of one f32 input.
    pub fn new(input: &str, shape: &[i64]) -> Self {
        let mut network = Self::default();
        network.graph.name = "network".to_owned();
        network.graph.input.push(value(input, FLOAT, shape));
        network
    }

    /// An array of constants, row-major.
    ///
    /// # Panics
    /// If the values do not fill the shape.
    pub fn constant(&mut self, name: &str, shape: &[i64], values: Vec<f32>) -> String {
        assert_eq!(shape.iter().product::<i64>(), values.len() as i64, "{name}");
        self.graph.initializer.push(TensorProto {
            dims: shape.to_vec(),
            data_type: FLOAT,
            float_data: values,
            name: name.to_owned(),
            ..Default::default()
        });
        name.to_owned()
    }

    /// A list of whole numbers.
    pub fn integers(&mut self, name: &str, values: &[i64]) -> String {
        self.graph.initializer.push(TensorProto {
            dims: vec![values.len() as i64],
            data_type: INT64,
            int64_data: values.to_vec(),
            name: name.to_owned(),
            ..Default::default()
        });
        name.to_owned()
    }

    /// Applies an operator; its one output is called `output`.
    pub fn apply(
        &mut self,
        operator: &str,
        inputs: &[&str],
        output: &str,
        settings: &[(&str, Setting<'_>)],
    ) -> String {
        let attribute = |(name, setting): &(&str, Setting<'_>)| {
            // 2 and 7 are INT and INTS of AttributeType.
            let (i, ints, r#type) = match *setting {
                Setting::Int(i) => (i, Vec::new(), 2),
                Setting::Ints(ints) => (0, ints.to_vec(), 7),
            };
            Attribute {
                name: (*name).to_owned(),
                i,
                ints,
                r#type,
            }
        };
        self.graph.node.push(NodeProto {
            input: inputs.iter().map(|&input| input.to_owned()).collect(),
            output: vec![output.to_owned()],
            name: format!("{operator}_{output}"),
            op_type: operator.to_owned(),
            attribute: settings.iter().map(attribute).collect(),
        });
        output.to_owned()
    }

    /// Declares an f32 value an output.
    pub fn output(&mut self, name: &str, shape: &[i64]) {
        self.graph.output.push(value(name, FLOAT, shape));
    }

    /// Declares a value of whole numbers an output.
    pub fn integer_output(&mut self, name: &str, shape: &[i64]) {
        self.graph.output.push(value(name, INT64, shape));
    }

    /// The file.
    pub fn encode(self) -> Vec<u8> {
        let model = ModelProto {
            ir_version: FORMAT,
            graph: Some(self.graph),
            opset_import: vec![OperatorSet {
                domain: String::new(),
                version: OPERATOR_SET,
            }],
        };
        model.encode_to_vec()
    }
}

fn value(name: &str, elem_type: i32, shape: &[i64]) -> ValueInfo {
    let dim = |&dim_value: &i64| Dimension { dim_value };
    let shape = Shape {
        dim: shape.iter().map(dim).collect(),
    };
    ValueInfo {
        name: name.to_owned(),
        r#type: Some(TypeProto {
            tensor_type: Some(TensorType {
                elem_type,
                shape: Some(shape),
            }),
        }),
    }
}
