// The colour network's inputs that describe a viewing direction.

// Quads of all inputs: three of features, then the direction's.
const INPUT_QUADS: u32 = 10u;
const VIEW_QUADS: u32 = 7u;

// The quads of a unit direction: itself and 1, then the sines and the cosines of its four octaves, axis by axis.
fn view_inputs(direction: vec3<f32>) -> array<vec4<f32>, VIEW_QUADS> {
    // Octaves by the double angle: sin 2x = 2 sin x cos x, cos 2x = 1 - 2 sin^2 x.
    let sin_1 = sine(direction);
    let cos_1 = cosine(direction);
    let sin_2 = 2.0 * sin_1 * cos_1;
    let cos_2 = 1.0 - 2.0 * sin_1 * sin_1;
    let sin_4 = 2.0 * sin_2 * cos_2;
    let cos_4 = 1.0 - 2.0 * sin_2 * sin_2;
    let sin_8 = 2.0 * sin_4 * cos_4;
    let cos_8 = 1.0 - 2.0 * sin_4 * sin_4;
    return array<vec4<f32>, VIEW_QUADS>(
        vec4<f32>(direction, 1.0),
        vec4<f32>(sin_1.x, sin_2.x, sin_4.x, sin_8.x),
        vec4<f32>(sin_1.y, sin_2.y, sin_4.y, sin_8.y),
        vec4<f32>(sin_1.z, sin_2.z, sin_4.z, sin_8.z),
        vec4<f32>(cos_1.x, cos_2.x, cos_4.x, cos_8.x),
        vec4<f32>(cos_1.y, cos_2.y, cos_4.y, cos_8.y),
        vec4<f32>(cos_1.z, cos_2.z, cos_4.z, cos_8.z),
    );
}
