"""The lens that a camera file's fields describe."""

from __future__ import annotations

from evalkit.errors import InputError
from evalkit.geometry.camera_fields import RADIAL, Fields, number, numbers
from evalkit.geometry.camera_matrix import NEGLIGIBLE
from evalkit.geometry.lens import Lens

FISHEYES = ("equi", "fisheye", "kannala", "omni", "mei", "unified", "ftheta", "f-theta", "eucm", "ds")
KNOWN_LENSES = (
    "plumb_bob", "rational_polynomial", "brown", "radtan", "none", "pinhole", "opencv", "perspective", "radial", "",
)  # fmt: skip
REALSENSE = {
    0: "none", 1: "modified_brown_conrady", 2: "inverse_brown_conrady", 3: "ftheta", 4: "brown_conrady",
    5: "kannala_brandt4",
}  # fmt: skip
SAME_COEFFICIENT = 1e-6


def refuse_fisheye(fields: Fields, where: str) -> None:
    """A fisheye's matrix is not a pinhole's, not even where all its coefficients are zero.

    Raises:
        InputError: the fields are of a fisheye lens.
    """
    model = " ".join(name for name in (_model(fields), str(fields.get("cameramodel", "")).lower()) if name)
    is_fisheye = any(name in model if len(name) > 3 else name in model.split() for name in FISHEYES)
    if is_fisheye or fields.get("fisheye") not in (None, 0, False):
        said = fields.get("model") or fields.get("cameramodel") or "fisheye"
        raise InputError(
            f"{where}: its distortion_model is '{said}', of a fisheye lens, but cameras are pinholes here; rectify the "
            "depth images, and give the pinhole camera that they were rectified to."
        )


def _model(fields: Fields) -> str:
    """The lens model's name in lower case; RealSense writes numbers too."""
    model = fields.get("model", "")
    if isinstance(model, int):
        return REALSENSE.get(model, str(model))
    return str(model).lower().removeprefix("distortion.").replace(" ", "_").replace("-", "_")


def lens_of(fields: Fields, skew: float, where: str) -> Lens | None:
    """The lens, None where it changes nothing.

    Raises:
        InputError: its fields contradict each other, or are of a model that is not known.
    """
    if "distortion" in fields:
        coefficients = tuple(numbers(fields["distortion"], where, "distortion_coefficients").tolist())
        for place, name in enumerate(RADIAL):
            listed = coefficients[place] if place < len(coefficients) else 0.0
            if name in fields and abs(number(fields, name, where) - listed) > SAME_COEFFICIENT:
                raise InputError(
                    f"{where}: '{name}' is {fields[name]:g}, but {listed:g} in the list of distortion coefficients; "
                    "keep the one that is right."
                )
    else:
        coefficients = tuple(number(fields, k, where) if k in fields else 0.0 for k in RADIAL)
    if not any(abs(c) > NEGLIGIBLE for c in coefficients):
        coefficients = ()
    if not coefficients and not abs(skew) > NEGLIGIBLE * max(1.0, abs(skew)):
        return None
    model = _model(fields)
    if coefficients and not any(name in model for name in KNOWN_LENSES if name) and model:
        raise InputError(
            f"{where}: its distortion_model '{fields['model']}' is not known; rectify the depth images, and give the "
            "pinhole camera that they were rectified to."
        )
    try:
        return Lens(coefficients, skew, inverse="inverse" in model, radial_first="modified" in model)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
