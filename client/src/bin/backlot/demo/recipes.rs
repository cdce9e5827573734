//! What the samples of a demo show: what free road allows, and on a recorded log, whose road is often full, what is possible once its
//! own movers make room.

use backlot_proto::v1;
use backlot_proto::v1::actor_edit::Edit;

use super::library::Library;

/// Probability that an original object of a recorded log is swapped: such logs have few free places.
const REPLACE_PROBABILITY: f64 = 0.5;

/// Of a recorded log's samples, one in so many moves its movers, and as many take them away and place others.
const EDITED_SHARE: u64 = 3;

/// Metres ahead and to the left, and degrees to the left, by which movers are moved in turn: within their lane and back to where they
/// drove themselves; what is ahead of one that stopped was in no image.
const SHIFTS: [(f64, f64, f64); 4] = [
    (-1.5, 0.3, 4.0),
    (-0.8, -0.3, -6.0),
    (-0.4, 0.4, 8.0),
    (-1.2, 0.0, -4.0),
];

/// The recipes of `count` samples, each with its number of consecutive samples. `base` has background, objects and sun.
pub(crate) fn recipes(
    base: &v1::Recipe,
    library: &Library,
    recorded: bool,
    count: u64,
) -> Vec<(v1::Recipe, u64)> {
    if !recorded {
        return vec![(base.clone(), count)];
    }
    let movers = own_movers(library);
    let edited = match movers.is_empty() {
        true => 0,
        false => count / EDITED_SHARE,
    };
    let swapped = v1::Recipe {
        replace_probability: REPLACE_PROBABILITY,
        ..base.clone()
    };
    let emptied = v1::Recipe {
        edits: edits(&movers, &Edit::Remove(v1::RemoveActor {})),
        ..base.clone()
    };
    let mut recipes = vec![(swapped, count - 2 * edited), (emptied, edited)];
    recipes.extend((0..edited).map(|i| {
        let (x_m, y_m, degrees) = SHIFTS[i as usize % SHIFTS.len()];
        let shift = v1::ShiftActor {
            x_m,
            y_m,
            heading_rad: degrees.to_radians(),
        };
        let moved = v1::Recipe {
            edits: edits(&movers, &Edit::Shift(shift)),
            // Movers in another place are enough to look at.
            min_objects: Some(0),
            max_objects: Some(0),
            ..base.clone()
        };
        (moved, 1)
    }));
    recipes.retain(|(_, count)| *count > 0);
    recipes
}

/// Tracks that move and of which an asset was trained that may be placed.
fn own_movers(library: &Library) -> Vec<String> {
    let usable = library
        .objects
        .iter()
        .filter(|asset| asset.usage() == v1::AssetUsage::Library);
    usable
        .map(|asset| asset.source_track_id.clone())
        .filter(|track| library.moving.contains(track))
        .collect()
}

fn edits(movers: &[String], edit: &Edit) -> Vec<v1::ActorEdit> {
    let edit = |track_id: &String| v1::ActorEdit {
        track_id: track_id.clone(),
        edit: Some(edit.clone()),
    };
    movers.iter().map(edit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asset(track: &str, usage: v1::AssetUsage) -> v1::Asset {
        v1::Asset {
            source_track_id: track.to_owned(),
            usage: usage.into(),
            ..Default::default()
        }
    }

    fn library(moving: &[&str]) -> Library {
        Library {
            background: v1::Asset::default(),
            objects: vec![
                asset("1", v1::AssetUsage::ReplayOnly),
                asset("2", v1::AssetUsage::Library),
                asset("3", v1::AssetUsage::Library),
            ],
            supplied: Vec::new(),
            moving: moving.iter().map(|t| (*t).to_owned()).collect(),
        }
    }

    #[test]
    fn a_recorded_log_shows_swaps_removals_and_moves_of_its_own_movers() {
        let base = v1::Recipe::default();
        let parts = recipes(&base, &library(&["1", "2"]), true, 12);
        let counts: Vec<u64> = parts.iter().map(|(_, count)| *count).collect();
        assert_eq!(counts, [4, 4, 1, 1, 1, 1]);
        for (recipe, _) in &parts[1..] {
            let tracks: Vec<&str> = recipe.edits.iter().map(|e| e.track_id.as_str()).collect();
            assert_eq!(tracks, ["2"], "1 has no asset to place, 3 does not move");
        }
        assert_eq!(recipes(&base, &library(&["1"]), true, 12).len(), 1);
        assert_eq!(recipes(&base, &library(&["2"]), true, 2).len(), 1);
        let street = recipes(&base, &library(&["2"]), false, 12);
        assert_eq!(street, [(base, 12)]);
    }
}
