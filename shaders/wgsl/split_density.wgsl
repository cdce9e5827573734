// Raw densities that are split over four bindings, since none holds them all.

// Nodes in each part but the last.
override NODES_PER_PART: u32;

fn node_density(node: u32) -> f32 {
    let at = node % NODES_PER_PART;
    switch node / NODES_PER_PART {
        case 0u: {
            return density[at];
        }
        case 1u: {
            return density_1[at];
        }
        case 2u: {
            return density_2[at];
        }
        default: {
            return density_3[at];
        }
    }
}
