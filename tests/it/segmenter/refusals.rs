//! A segmenter that is not what its settings say is refused before the server takes a call.

use std::path::{Path, PathBuf};

use backlot_e2e::server::refused_start_with;
use backlot_server::segment::{Layout, RuntimeKind, SegmenterSettings, open};

use super::networks::settings;

/// Writes a server's configuration and returns its path.
pub(super) fn config(folder: &Path, text: &str) -> String {
    let path = folder.join("server.toml");
    std::fs::write(&path, text).unwrap();
    path.to_string_lossy().into_owned()
}

#[test]
fn a_segmenter_that_cannot_be_opened_is_named_at_start() {
    let folder = tempfile::tempdir().unwrap();
    let said = |text: &str| {
        let config = config(folder.path(), text);
        let data = folder.path().join("data");
        let (status, said) = refused_start_with(&data, &["--config", &config]);
        assert!(!status.success(), "{text}");
        std::fs::remove_file(data.with_extension("log")).unwrap();
        assert!(!data.exists(), "nothing is made: {text}");
        said
    };
    let table = |line: &str| {
        format!(
            "[segmenter]\nlayout = \"yolo-seg\"\ninput_px = [512, 384]\nclasses = {{ 2 = \"vehicle\" }}\n{line}"
        )
    };
    let none = said(&table(""));
    assert!(none.contains("segmenter.model: is not set"), "{none}");
    let missing = said(&table("model = \"no/such.onnx\""));
    assert!(
        missing.contains("read segmenter.model no/such.onnx"),
        "{missing}"
    );
    let score = said(&table("model = \"m.onnx\"\nleast_score = 2.0"));
    assert!(score.contains("segmenter.least_score: 2 is not"), "{score}");
    let model = folder.path().join("empty.onnx");
    std::fs::write(&model, b"").unwrap();
    let model = model.display();
    let library = said(&table(&format!(
        "model = \"{model}\"\nlibrary = \"/no/libonnxruntime.so\""
    )));
    assert!(library.contains("segmenter.library"), "{library}");
    assert!(library.contains("/no/libonnxruntime.so"), "{library}");
}

#[test]
fn a_model_that_is_not_what_the_settings_say_is_refused() {
    check_refusals(RuntimeKind::Tract);
}

#[test]
#[ignore = "needs the shared library of ONNX Runtime: tests/onnxruntime_ci.sh"]
fn onnxruntime_refuses_a_model_that_is_not_what_the_settings_say() {
    check_refusals(RuntimeKind::OnnxRuntime);
}

fn check_refusals(runtime: RuntimeKind) {
    let folder = tempfile::tempdir().unwrap();
    let yolo = settings(folder.path(), Layout::YoloSeg, runtime);
    let refused = |settings: &SegmenterSettings| open(settings, 1).unwrap_err().to_string();
    let layout = refused(&SegmenterSettings {
        layout: Layout::MaskRcnn,
        ..yolo.clone()
    });
    assert!(layout.contains("segmenter.layout"), "{layout}");
    assert!(layout.contains("output1 [1, 32, 96, 128]"), "{layout}");
    let size = refused(&SegmenterSettings {
        input_px: (640, 384),
        ..yolo.clone()
    });
    assert!(
        size.contains("segmenter.input_px: the model's input is [1, 3, 384, 512]"),
        "{size}"
    );
    let damaged: PathBuf = folder.path().join("damaged.onnx");
    let whole = std::fs::read(&yolo.model).unwrap();
    std::fs::write(&damaged, &whole[..whole.len() / 2]).unwrap();
    let damaged = refused(&SegmenterSettings {
        model: damaged,
        ..yolo
    });
    assert!(damaged.contains("segmenter.model"), "{damaged}");
}
