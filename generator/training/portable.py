"""Makes models that run without torch: weights in half the bytes, and the network in ONNX.

The folder that :func:`write_portable` leaves is read by :mod:`generator.runtime`, and by
:func:`generator.checkpoint.load` as well: both see the same numbers, for the weights are rounded
before the network is written.
"""

from __future__ import annotations

import copy
import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from generator import checkpoint
from generator.denoiser import Denoiser
from generator.diffusion import STEPS
from generator.model import InterGen
from generator.model_folder import HEADER, place_file, read_header, remove_others
from generator.runtime.network import INPUTS, OUTPUT, Network
from generator.runtime.portable import NETWORK, PRECISIONS, REPERTOIRE, Precision, Sampling
from generator.training.card import CARD, Figures, model_card
from generator.training.config import INVENTED, load_config
from generator.training.train import CONFIG
from robots.errors import CheckpointError, MotionFileError, SpecError
from robots.files import whole_file

OPSET = 17
"""Version of the ONNX operators: the first with layer norms."""
SMALL = 4096
"""Arrays of fewer numbers (biases, tables of shapes) are stored as they are."""
AGREEMENT = {"float32": 1e-3, "float16": 1e-3, "int8": 0.2}
"""Largest difference to torch that is let pass, relative to the largest number: the first two
multiply the same numbers, the last is to be of the same kind."""
INSTALL = "pip install 'pasdedeux[train]'"


class _Traceable(nn.Module):
    """The denoiser with the positions that a model needs, and its products all of one kind.

    Times and texts go through as sequences of one: products of two plain matrices would become
    another ONNX operator, which the quantiser leaves alone.
    """

    def __init__(self, denoiser: Denoiser, frames: int) -> None:
        super().__init__()
        self.denoiser = copy.deepcopy(denoiser)
        self.denoiser.positions = denoiser.positions[: max(STEPS, frames)].clone()

    def forward(self, x: Tensor, t: Tensor, cond: Tensor) -> Tensor:
        text = self.denoiser.read(cond)[:, :, None]
        modulations = self.denoiser.modulations(t[:, None], text)
        return self.denoiser.denoise(x, modulations.squeeze(3))


def pack(
    run: str | Path,
    folder: str | Path,
    *,
    precision: Precision = "float16",
    sampling: Mapping[str, Any] | None = None,
    figures: Figures | None = None,
) -> dict[str, int]:
    """Write the model of a run for use without torch; return the bytes of each file.

    The same run and the same wishes leave the same files.

    Args:
        run: Folder that ``pasdedeux train`` left, finished or not.
        folder: Made if it does not exist; an older model in it is replaced.
        precision: Of the network.
        sampling: Settings of :class:`~generator.runtime.portable.Sampling`, besides the length.
        figures: What was measured of the model, for its card.

    Raises:
        CheckpointError: There is no such model, or one of the reasons of :func:`write_portable`.
        SpecError: There is no such precision, or a setting is out of range.
    """
    model = checkpoint.load(run)
    frames = model.provenance.training.get("frames")
    if not isinstance(frames, int):
        raise CheckpointError(
            "the model does not say how long its motions may be",
            where=str(run),
            hint="pack the folder of a run, which 'pasdedeux train' left",
        )
    write_portable(
        model,
        folder,
        frames=frames,
        precision=precision,
        sampling=sampling,
        repertoire=_knows_the_repertoire_alone(Path(run)),
        figures=figures,
    )
    header = read_header(folder)
    names = (HEADER, CARD, header["weights"]["file"], header[NETWORK]["file"])
    return {name: (Path(folder) / name).stat().st_size for name in names}


def _knows_the_repertoire_alone(run: Path) -> bool:
    """Return whether all that a run learns from was invented by the choreographer."""
    if not (run / CONFIG).is_file():
        return read_header(run).get(REPERTOIRE) is True
    return {source.kind for source in load_config(run / CONFIG).data.source} <= {*INVENTED}


def write_portable(
    model: InterGen,
    folder: str | Path,
    *,
    frames: int,
    precision: Precision = "float16",
    sampling: Mapping[str, Any] | None = None,
    repertoire: bool = False,
    figures: Figures | None = None,
) -> Path:
    """Write a model for use without torch, whole or not at all; return the path of its network.

    Args:
        model: With statistics.
        folder: Made if it does not exist; an older model in it is replaced.
        frames: Longest motion that may be drawn.
        precision: Of the network.
        sampling: Settings of :class:`~generator.runtime.portable.Sampling`.
        repertoire: Whether it has seen the choreographer's repertoire and nothing else; it is not
            drawn from for other sentences.
        figures: What was measured of it, for its card.

    Raises:
        CheckpointError: The package ``onnx`` is missing, the model has no statistics, the network
            does not do what the model does, or the folder cannot be written to.
        SpecError: There is no such precision, or a setting is out of range.
    """
    if precision not in PRECISIONS:
        raise SpecError(f"precision {precision!r}", allowed=" or ".join(PRECISIONS))
    chosen = Sampling(frames=frames, **(sampling or {}))
    if not model.has_statistics:
        raise CheckpointError("the model has no statistics", where=model.provenance.source)
    model = rounded(model)
    folder = Path(folder)

    def write(path: str) -> None:
        write_network(model.denoiser, path, frames=frames, precision=precision)
        require_agreement(model.denoiser, Network(path), AGREEMENT[precision])

    try:
        entry = place_file(folder, NETWORK, "onnx", write)
    except OSError as error:
        raise CheckpointError(f"cannot be written: {error}", where=str(folder)) from error
    statistics = {name: getattr(model, name).tolist() for name in ("mean", "std")}
    header = {
        NETWORK: {**entry, "precision": precision},
        "statistics": statistics,
        "sampling": asdict(chosen),
        REPERTOIRE: repertoire,
    }
    checkpoint.save(model, folder, half=True, **header)
    remove_others(folder, entry)
    try:
        with whole_file(folder / CARD) as file:
            file.write(model_card(model, chosen, precision, repertoire, figures).encode())
    except MotionFileError as error:
        raise CheckpointError(f"cannot be written: {error}", where=str(folder)) from error
    return folder / entry["file"]


def rounded(model: InterGen) -> InterGen:
    """Return a copy whose weights are numbers that 16 bits hold."""
    result = copy.copy(model)  # the text encoder cannot be copied, and need not be
    result._modules = dict(model._modules)
    result.denoiser = copy.deepcopy(model.denoiser)
    with torch.no_grad():
        for parameter in result.denoiser.parameters():
            parameter.copy_(parameter.half())
    return result.eval()


def write_network(
    denoiser: Denoiser, path: str | Path, *, frames: int, precision: Precision = "float32"
) -> None:
    """Write a denoiser as an ONNX network for any number of motions of up to ``frames``.

    Raises:
        CheckpointError: The package ``onnx`` is missing.
        OSError: The file cannot be written.
    """
    try:
        import onnx
    except ImportError as error:
        raise CheckpointError(
            f"writing a network needs the package '{error.name}'", hint=INSTALL
        ) from error
    with tempfile.TemporaryDirectory() as scratch:
        traced, quantised = Path(scratch) / "traced.onnx", Path(scratch) / "quantised.onnx"
        _trace(denoiser, traced, frames)
        if precision == "int8":
            _quantise(traced, quantised)
            _simplify(quantised, Path(path))
            return
        network = onnx.load(traced)
        if precision == "float16":
            _store_half(network)
        onnx.save(network, str(path))


def _trace(denoiser: Denoiser, path: Path, frames: int) -> None:
    """Write the network as torch's exporter sees it.

    The exporter that traces is used, not its successor: that one would need two more packages, and
    this network has no branches that a trace could miss.
    """
    config = denoiser.config
    inputs = (torch.zeros(2, 3, 2 * config.features), torch.zeros(2).long(),
              torch.zeros(2, config.text_width))  # fmt: skip
    axes = {name: {0: "motions"} for name in (*INPUTS, OUTPUT)}
    for name in (INPUTS[0], OUTPUT):
        axes[name][1] = "frames"
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # that it is deprecated, and that shapes are constants
        torch.onnx.export(
            _Traceable(denoiser, frames).eval(),
            inputs,
            str(path),
            dynamo=False,
            opset_version=OPSET,
            input_names=list(INPUTS),
            output_names=[OUTPUT],
            dynamic_axes=axes,
        )


def _simplify(source: Path, target: Path) -> None:
    """Write a network without what can be computed beforehand, in operators of the standard.

    The trace holds the arithmetic of its shapes, thousands of nodes; who loads the network would
    spend more time on getting rid of them than on a step of sampling.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
    options.optimized_model_filepath = str(target)
    options.log_severity_level = 3
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    onnxruntime.InferenceSession(str(source), options, providers=["CPUExecutionProvider"])


def _quantise(source: Path, target: Path) -> None:
    """Write a network whose products with weights are of 8-bit numbers.

    What goes in is scaled anew at every call (dynamic quantisation), the weights have one scale per
    column; products of two activations, inside of attention, stay as they are.
    """
    import onnx
    from onnxruntime.quantization import QuantType, quantize_dynamic

    network = onnx.load(source)
    # Else a warning asks for a preparation, which is what the exporter has done already.
    onnx.helper.set_model_props(network, {"onnx.quant.pre_process": "onnxruntime.quant"})
    quantize_dynamic(
        network,
        target,
        op_types_to_quantize=["MatMul"],
        per_channel=True,
        weight_type=QuantType.QInt8,
    )


def _store_half(network: Any) -> None:
    """Store large arrays in half the bytes; onnxruntime makes them single precision as it loads.

    An array that would change, such as the table of sinusoids, is left as it is.
    """
    from onnx import TensorProto, helper, numpy_helper

    casts = []
    for array in network.graph.initializer:
        if array.data_type != TensorProto.FLOAT or np.prod(array.dims) < SMALL:
            continue
        name, values = array.name, numpy_helper.to_array(array)
        half = values.astype(np.float16)
        if not np.array_equal(half.astype(np.float32), values):
            continue
        array.CopyFrom(numpy_helper.from_array(half))
        array.name = f"{name}.half"
        casts.append(helper.make_node("Cast", [array.name], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *network.graph.node]
    del network.graph.node[:]
    network.graph.node.extend(nodes)


@torch.no_grad()
def require_agreement(denoiser: Denoiser, network: Network, largest: float) -> float:
    """Return the largest difference between a denoiser and its network, relative to its numbers.

    Raises:
        CheckpointError: It is above ``largest``, or the network gives no numbers.
    """
    config = denoiser.config
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2, 5, 2 * config.features), np.float32)
    t = np.array([STEPS - 1, STEPS // 4])
    cond = rng.standard_normal((2, config.text_width), np.float32)
    cond /= np.linalg.norm(cond, axis=1, keepdims=True)
    truth = denoiser(*(torch.from_numpy(array) for array in (x, t, cond))).numpy()
    error = np.abs(network(x, t, cond) - truth).max() / max(float(np.abs(truth).max()), 1.0)
    if not error <= largest:
        raise CheckpointError(
            f"the network is off by {error:.1e}", allowed=f"{largest:g}", where="export"
        )
    return float(error)
