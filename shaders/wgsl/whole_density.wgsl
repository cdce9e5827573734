// Raw densities that one binding holds.

fn node_density(node: u32) -> f32 {
    return density[node];
}
