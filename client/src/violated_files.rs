//! Names the files behind the fields of a manifest that the server found wrong.

use backlot_proto::v1;
use tonic::Status;
use tonic_types::{FieldViolation, StatusExt};

use crate::read_log::{BlobSource, ReadLog};

/// The status with the file added to the description of each violated field whose blob is one.
pub(crate) fn with_files(status: Status, log: &ReadLog) -> Status {
    let mut details = status.get_error_details();
    let Some(found) = details.bad_request() else {
        return status;
    };
    let named = found.field_violations.iter().map(|violation| {
        let file = file_of(&violation.field, log);
        let file = file.map_or_else(String::new, |file| format!(" [{file}]"));
        FieldViolation::new(&violation.field, violation.description.clone() + &file)
    });
    let named: Vec<FieldViolation> = named.collect();
    details.set_bad_request(named);
    Status::with_error_details(status.code(), status.message(), details)
}

fn file_of(field: &str, log: &ReadLog) -> Option<String> {
    let digest = &blob_of(field, &log.drive_log)?.digest;
    match log.blobs.get(digest)? {
        BlobSource::File(path) => Some(path.display().to_string()),
        BlobSource::Memory(_) | BlobSource::Spooled { .. } => None,
    }
}

/// The blob that a field path as `frames[3].image` names.
fn blob_of<'a>(field: &str, log: &'a v1::DriveLog) -> Option<&'a v1::BlobRef> {
    let (list, rest) = field.split_once('[')?;
    let (index, member) = rest.split_once("].")?;
    let index: usize = index.parse().ok()?;
    if list == "sweeps" {
        return log.sweeps.get(index)?.points.as_ref();
    }
    let frame = log.frames.get(index).filter(|_| list == "frames")?;
    match member {
        "image" => frame.image.as_ref(),
        "instance_mask" => frame.instance_mask.as_ref(),
        "free_instance_mask" => frame.free_instance_mask.as_ref(),
        "sky_mask" => frame.sky_mask.as_ref(),
        "depth_map.image" => frame.depth_map.as_ref()?.image.as_ref(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use tonic::Code;
    use tonic_types::ErrorDetails;

    use super::*;

    fn log() -> ReadLog {
        let mut log = ReadLog::default();
        let image = crate::read_log::blob_ref(b"one");
        log.add_file("day/0001.png".as_ref(), &image);
        let made = log.add_bytes(&b"two"[..]);
        log.drive_log.frames = [image, made]
            .map(|image| v1::CameraFrame {
                image: Some(image),
                ..Default::default()
            })
            .to_vec();
        log
    }

    fn described(field: &str) -> String {
        let details = ErrorDetails::with_bad_request_violation(field, "does not decode");
        let status = Status::with_error_details(Code::InvalidArgument, "not valid", details);
        let named = with_files(status, &log());
        assert_eq!(named.message(), "not valid");
        let details = named.get_error_details();
        details.bad_request().unwrap().field_violations[0]
            .description
            .clone()
    }

    #[test]
    fn the_file_of_a_violated_field_is_named_where_there_is_one() {
        assert_eq!(
            described("frames[0].image"),
            "does not decode [day/0001.png]"
        );
        for field in [
            "frames[1].image",
            "frames[7].image",
            "frames[0].timestamp_ns",
            "tracks[0].size_m",
            "name",
        ] {
            assert_eq!(described(field), "does not decode", "{field}");
        }
    }
}
