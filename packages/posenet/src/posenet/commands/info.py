"""What `posenet info` prints."""

from __future__ import annotations

import json
from pathlib import Path

from posenet.device import choose_device, layers_in_bf16
from posenet.models.model_file import load_model


def summary(model: Path, as_json: bool = False) -> str:
    """What a model file, or a run's folder, says of itself, in lines or as JSON, and its precision on this machine."""
    trained = load_model(model)
    network, record = trained.network, trained.record
    precision = "bfloat16" if layers_in_bf16("auto", choose_device("auto")) else "float32"
    if as_json:
        document = {
            "config": network.config.to_json(),
            "object": network.model.to_json(),
            "camera": network.camera.to_json(),
            "depth_range": network.depth_range,
            "precision": precision,
            "record": record,
        }
        return json.dumps(document, indent=1)
    count = sum(p.numel() for p in network.parameters())
    ap = record.get("validation_ap")
    camera = network.camera
    return "\n".join(
        [
            f"model       {model}",
            f"object      {network.model.title}, diameter {network.model.diameter * 1e3:.1f} mm, "
            f"symmetry {network.model.symmetry.name}",
            f"preset      {network.config.preset}, {count / 1e6:.2f} M parameters",
            f"camera      {camera.width} x {camera.height}, fx {camera.fx:.1f}, "
            f"objects {network.depth_range[0]:.3f} to {network.depth_range[1]:.3f} m away",
            f"training    {record['minutes']:.1f} minutes, {record['images']} images, seed {record['seed']}",
            f"precision   {precision} layers when this machine predicts; 'posenet predict --precision' chooses another",
            "validation  "
            + (
                f"AP {ap:.3f} on {record['validation_images']} images; {record['protocol']}"
                if ap is not None
                else "none"
            ),
        ]
    )
