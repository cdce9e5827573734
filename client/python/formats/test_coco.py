"""COCO files read by pycocotools."""

import contextlib
import io
import json

import numpy as np
import pytest
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval
from sets import NAMES, SETS, copied, truths


def read(folder):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(str(folder / "coco.json"))


def faults(folder):
    """Where pycocotools sees other boxes or masks than the instance images hold."""
    coco = read(folder)
    found = []
    images = {image["file_name"]: image for image in coco.loadImgs(coco.getImgIds())}
    frames = truths(folder)
    if set(images) != {truth.image for truth in frames}:
        found.append("other images")
    for truth in frames:
        annotations = coco.loadAnns(coco.getAnnIds(imgIds=[images[truth.image]["id"]]))
        objects = [a for a in annotations if not a["iscrowd"]]
        crowds = [a for a in annotations if a["iscrowd"]]
        if len(objects) != len(truth.shown):
            found.append(f"{truth.image}: {len(objects)} objects of {len(truth.shown)}")
        for annotation in objects:
            shown = truth.shown[annotation["instance_id"] % 65536]
            if not np.array_equal(coco.annToMask(annotation), shown.mask):
                found.append(f"{truth.image}: mask of {shown.id}")
            rows, columns = np.nonzero(shown.mask)
            box = [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
            if annotation["bbox"] != box or annotation["area"] != len(rows):
                found.append(f"{truth.image}: box of {shown.id}")
            if coco.loadCats(annotation["category_id"])[0]["name"] != shown.name:
                found.append(f"{truth.image}: class of {shown.id}")
        if (truth.ignore is None) != (not crowds):
            found.append(f"{truth.image}: ignored pixels")
        for crowd in crowds:
            if not np.array_equal(coco.annToMask(crowd), truth.ignore):
                found.append(f"{truth.image}: ignored mask")
    return found


@pytest.mark.parametrize("name", NAMES)
def test_pycocotools_reads_boxes_masks_and_classes(name):
    assert faults(SETS / name) == []


@pytest.mark.parametrize("kind", ["bbox", "segm"])
def test_the_labels_detect_themselves(kind):
    coco = read(SETS / "images")
    annotations = [a for a in coco.loadAnns(coco.getAnnIds()) if not a["iscrowd"]]
    with contextlib.redirect_stdout(io.StringIO()):
        results = coco.loadRes([{**a, "score": 1.0} for a in annotations])
        evaluation = COCOeval(coco, results, kind)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    assert evaluation.stats[0] == pytest.approx(1.0)


def _moved_box(file):
    next(a for a in file["annotations"] if not a["iscrowd"])["bbox"][0] += 1


def _other_mask(file):
    objects = [a for a in file["annotations"] if not a["iscrowd"]]
    objects[0]["segmentation"] = next(
        a["segmentation"] for a in objects[1:] if a["segmentation"] != objects[0]["segmentation"]
    )


def _lost_object(file):
    file["annotations"].remove(next(a for a in file["annotations"] if not a["iscrowd"]))


@pytest.mark.parametrize("breakage", [_moved_box, _other_mask, _lost_object])
def test_broken_files_are_refused(breakage, tmp_path):
    folder = copied("images", tmp_path / "set")
    file = json.loads((folder / "coco.json").read_text())
    breakage(file)
    (folder / "coco.json").write_text(json.dumps(file))
    assert faults(folder) != []
