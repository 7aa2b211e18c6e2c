"""The evaluation protocol, and the training of its evaluator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from generator.architecture import DenoiserConfig
from generator.assessment import First, held_out
from generator.data import BatchConfig, BatchStream, DuetFolder, measure
from generator.diffusion import SamplerConfig
from generator.drawing import draw_real, embed, generate
from generator.evaluation import MODEL, REAL, EvaluationConfig, Watch, evaluate
from generator.evaluator import EvaluatorConfig, InterClip
from generator.io import write_motion
from generator.metrics import PAPER, RELEASE, Protocol
from generator.model import InterGen
from generator.provenance import Provenance
from generator.scores import SCALES, figures, spread_figures, summarise
from generator.training.config import parse
from generator.training.contrastive import ContrastiveConfig, fold, same_texts, train_evaluator
from robots.errors import CheckpointError, SpecError
from robots.files import read_archive

CLIPS = 10
POOLS = {"paper": replace(PAPER, pool=4), "release": replace(RELEASE, pool=64)}
TINY = EvaluatorConfig(
    width=16, layers=1, heads=2, feedforward=16, embedding=8, dropout=0.0, text="sentence",
    text_width=8,
)  # fmt: skip


class Words:
    """A frozen sentence encoder: a random vector per sentence."""

    def encode(self, sentences: Any) -> np.ndarray:
        rows = [
            np.random.default_rng(list(s.encode())).standard_normal(8).astype(np.float32)
            for s in sentences
        ]
        return np.stack(rows)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory, make_duet: Any) -> DuetFolder:
    """Duets of different lengths, each with a sentence of its own."""
    root = tmp_path_factory.mktemp("duets")
    for i in range(CLIPS):
        duet = replace(make_duet(frames=18 + i % 3, seed=i), text=f"they do thing number {i}")
        write_motion(duet, root / f"{i}.npz")
    return DuetFolder(root)


@pytest.fixture(scope="module")
def model(clips: DuetFolder) -> InterGen:
    torch.manual_seed(0)
    found = measure(clips, frames=16)
    config = DenoiserConfig(width=8, layers=1, heads=2, feedforward=8, text_width=8)
    made = InterGen(
        config,
        mean=found.mean.copy(),
        std=found.std.copy(),
        text=Words(),
        provenance=Provenance("test", "CC0", 30.0),
    )
    for parameter in made.parameters():
        parameter.data.normal_(0, 0.05)
    return made.eval()


@pytest.fixture(scope="module")
def evaluator() -> InterClip:
    torch.manual_seed(1)
    return InterClip(TINY, sentences=Words()).eval()


@pytest.fixture
def _small_pools(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, scale in POOLS.items():
        monkeypatch.setitem(SCALES, name, scale)


CONFIG = EvaluationConfig(
    repetitions=3,
    multimodality_repetitions=2,
    multimodality_texts=2,
    multimodality_motions=4,
    frames=16,
    batch=4,
    sampler=SamplerConfig(steps=2),
)


@pytest.mark.usefixtures("_small_pools")
def test_an_evaluation_reports_real_motions_first_and_keeps_its_outputs(
    model: InterGen, evaluator: InterClip, clips: DuetFolder, tmp_path: Path
) -> None:
    said: list[str] = []
    report = evaluate(model, evaluator, clips, tmp_path, CONFIG, watch=Watch(announce=said.append))
    assert list(report["rows"]) == [REAL, MODEL]
    real = next(i for i, line in enumerate(said) if line.startswith(REAL))
    assert real < next(i for i, line in enumerate(said) if "repetition 1" in line)
    rows = report["rows"]
    assert rows[MODEL]["paper"]["r_precision_top1"]["runs"] == 3
    assert rows[MODEL]["paper"]["multimodality"]["runs"] == 2
    assert rows[MODEL]["release"]["r_precision_top1"] is None  # 10 clips fill no pool of 64
    assert "multimodality" not in rows[REAL]["paper"]
    paper, release = (rows[MODEL][scale] for scale in ("paper", "release"))
    assert release["fid"]["mean"] == pytest.approx(36 * paper["fid"]["mean"], rel=1e-6)
    assert release["diversity"]["mean"] == pytest.approx(3 * paper["diversity"]["mean"], rel=1e-6)
    assert release["mm_dist"] == paper["mm_dist"]
    header, arrays = read_archive(tmp_path / "repetition-00.npz")
    assert header is not None
    assert len(header["names"]) == len(header["texts"]) == CLIPS
    assert arrays["keypoints"].shape == (arrays["lengths"].sum(), 2, 22, 3)
    assert arrays["generated"].shape == arrays["text"].shape == (CLIPS, 8)
    assert arrays["spread"].shape == (2, 4, 8)
    assert arrays["seeds"].shape == (CLIPS, 3)


@pytest.mark.usefixtures("_small_pools")
def test_the_figures_can_be_recomputed_from_what_is_kept(
    model: InterGen, evaluator: InterClip, clips: DuetFolder, tmp_path: Path
) -> None:
    report = evaluate(model, evaluator, clips, tmp_path, CONFIG)
    found = []
    reference = draw_real(evaluator, _stream(clips), 0).motion
    for r in range(3):
        _, arrays = read_archive(tmp_path / f"repetition-{r:02d}.npz")
        found.append(figures(arrays["text"], arrays["generated"], reference, [0, r]))
    again = summarise(found)["paper"]
    for name in ("r_precision_top1", "fid", "mm_dist", "diversity"):
        assert again[name] == report["rows"][MODEL]["paper"][name]


@pytest.mark.usefixtures("_small_pools")
def test_an_evaluation_goes_on_from_what_is_there(
    model: InterGen, evaluator: InterClip, clips: DuetFolder, tmp_path: Path
) -> None:
    first = evaluate(model, evaluator, clips, tmp_path, CONFIG)
    stamps = [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("*.npz"))]
    more = replace(CONFIG, repetitions=4)
    evaluate(model, evaluator, clips, tmp_path, more)
    kept = [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("*.npz"))]
    assert kept[:3] == stamps
    assert len(kept) == 4
    (tmp_path / "repetition-01.npz").write_bytes(b"broken")
    assert evaluate(model, evaluator, clips, tmp_path, CONFIG)["rows"] == first["rows"]
    other = evaluate(model, evaluator, clips, tmp_path, CONFIG, identity={"model": "another"})
    assert other["rows"] == first["rows"]
    assert (tmp_path / "repetition-00.npz").stat().st_mtime_ns != stamps[0]


def _stream(clips: DuetFolder) -> BatchStream:
    return BatchStream(clips, BatchConfig(size=4, frames=16, mirror=False, pad="longest"))


def test_a_draw_holds_every_clip_once_and_each_draw_is_its_own(
    evaluator: InterClip, clips: DuetFolder
) -> None:
    draws = [draw_real(evaluator, _stream(clips), r) for r in (0, 1, 0)]
    assert sorted(draws[0].names) == sorted(draws[1].names) == [f"{i}.npz" for i in range(CLIPS)]
    assert draws[0].names != draws[1].names
    assert np.array_equal(draws[0].motion, draws[2].motion)
    assert np.linalg.norm(draws[0].text, axis=1) == pytest.approx(
        float(evaluator.latent_scale.detach()), rel=1e-5
    )


def test_embeddings_do_not_depend_on_neighbours(evaluator: InterClip) -> None:
    rng = np.random.default_rng(0)
    motions = [rng.standard_normal((n, 524)).astype(np.float32) for n in (9, 4, 16, 7, 7)]
    together, alone = embed(evaluator, motions, 5), embed(evaluator, motions, 1)
    np.testing.assert_allclose(together, alone, atol=1e-5)


def test_a_motion_does_not_depend_on_what_it_is_generated_with(model: InterGen) -> None:
    texts, lengths = ["one", "two", "three"], np.array([8, 8, 12])
    sampler = SamplerConfig(steps=3)
    seeds = [[0, i] for i in range(3)]
    together = generate(model, texts, lengths, seeds, sampler, batch=4)
    alone = generate(model, texts[1:2], lengths[1:2], seeds[1:2], sampler, batch=1)
    assert [len(x) for x in together] == [8, 8, 12]
    np.testing.assert_allclose(together[1], alone[0], atol=1e-5)
    assert np.abs(together[0] - together[1]).max() > 1e-3


@pytest.mark.usefixtures("_small_pools")
def test_a_perfect_model_scores_as_well_as_real_motions() -> None:
    """Embeddings that equal those of their sentences: first among all, at no distance."""
    rng = np.random.default_rng(0)
    text = rng.standard_normal((12, 6)).astype(np.float32)
    found = figures(text, text, text, [0])["paper"]
    assert (found["r_precision_top1"], found["mm_dist"]) == (1.0, 0.0)
    assert found["fid"] == pytest.approx(0, abs=1e-5)
    shifted = figures(text, text + 1, text, [0])["paper"]
    assert shifted["fid"] == pytest.approx(6, rel=1e-4)
    assert shifted["mm_dist"] == pytest.approx(np.sqrt(6), rel=1e-5)


def test_multimodality_is_zero_without_variety_and_takes_the_scale_s_motions() -> None:
    row = np.random.default_rng(0).standard_normal((3, 1, 5), np.float32)
    one = np.repeat(row, 30, axis=1)
    assert spread_figures(one, "paper", [0])["multimodality"] == pytest.approx(0, abs=1e-9)
    late = one.copy()
    late[:, PAPER.motions_per_text :] += 100  # motions that only the release's protocol takes
    assert spread_figures(late, "paper", [0])["multimodality"] == pytest.approx(0, abs=1e-9)
    assert (spread_figures(late, "release", [0])["multimodality"] or 0) > 10
    assert spread_figures(None, "paper", [0]) == {}


def test_intervals_are_those_of_the_repetitions() -> None:
    runs = [{s: {"fid": float(v), "top": None} for s in SCALES} for v in (1, 2, 3, 4)]
    found = summarise(runs)["paper"]
    assert found["top"] is None
    assert found["fid"]["mean"] == 2.5
    assert found["fid"]["interval"] == pytest.approx(1.96 * np.std([1, 2, 3, 4]) / 2)
    assert found["fid"]["runs"] == 4


def test_an_evaluator_learns_to_find_the_sentence_of_a_motion(clips: DuetFolder) -> None:
    stream = BatchStream(clips, BatchConfig(size=CLIPS, frames=16, mirror=False, swap=False))
    statistics = measure(clips, frames=16)
    shares: list[float] = []
    config = ContrastiveConfig(architecture=TINY, steps=60, learning_rate=1e-2)
    evaluator = train_evaluator(
        stream,
        statistics,
        Words(),
        config,
        report=lambda step, loss, share: shares.append(share),
    )
    assert shares[-1] >= 0.8
    # The statistics went into the first layer: the evaluator takes metres.
    batch = stream.batch(1000)
    with torch.no_grad():
        motions = evaluator.embed_motion(
            torch.from_numpy(batch.x_raw), torch.from_numpy(batch.lengths)
        )
        texts = evaluator.embed_text(evaluator.prepare(batch.texts))
    nearest = torch.cdist(texts, motions).argmin(dim=1)
    assert float((nearest == torch.arange(CLIPS)).float().mean()) >= 0.8


def test_the_normalisation_goes_into_the_first_layer(clips: DuetFolder) -> None:
    """Metres after folding give the embeddings that normalised features gave before."""
    torch.manual_seed(2)
    evaluator = InterClip(TINY, sentences=Words()).eval()
    batch = _stream(clips).batch(0)
    raw, lengths = torch.from_numpy(batch.x_raw), torch.from_numpy(batch.lengths)
    found = measure(clips, frames=16)
    mean, std = (torch.tensor(x, dtype=torch.float32) for x in (found.mean, found.std))
    with torch.no_grad():
        before = evaluator.embed_motion(
            ((raw.unflatten(-1, (2, -1)) - mean) / std).flatten(2), lengths
        )
        unfolded = evaluator.embed_motion(raw, lengths)
        fold(evaluator, mean, std)
        after = evaluator.embed_motion(raw, lengths)
    torch.testing.assert_close(after, before, rtol=0, atol=1e-3)
    assert float((unfolded - before).abs().max()) > 0.1


def test_equal_sentences_are_one_group(clips: DuetFolder) -> None:
    batch = _stream(clips).batch(0)
    batch = replace(batch, texts=("a", "b", "a", "c"))
    groups = same_texts(batch).tolist()
    assert groups[0] == groups[2]
    assert len(set(groups)) == 3


def test_wrong_requests_are_refused(model: InterGen, evaluator: InterClip, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="repetitions"):
        EvaluationConfig(repetitions=0)
    with pytest.raises(SpecError, match="sentence"):
        ContrastiveConfig(architecture=replace(TINY, text="tokens"))
    plain = InterGen(model.config, text=Words())
    with pytest.raises(CheckpointError, match="statistics"):
        evaluate(plain, evaluator, First(_Nothing(), 0), tmp_path)


class _Nothing:
    def __len__(self) -> int:
        return 0

    def clip(self, index: int) -> Any:
        raise IndexError(index)


def test_held_out_clips_are_other_ones_than_those_of_training() -> None:
    run = parse({"data": {"source": [{"kind": "choreographed", "seed": 4}]}})
    found = held_out("", run)
    assert (found.kind, found.count) == ("choreographed", 300)
    assert found.seed != 4
    human = parse({"data": {"source": [{"kind": "interhuman", "root": "x"}]}})
    assert (held_out("", human).split, held_out("", human).root) == ("test", "x")
    assert held_out("interhuman:y", None).split == "test"
    assert held_out("choreographed:7", None).count == 7
    for data, words in (("", "--data"), ("dutes:x", "did you mean 'duets'"), ("duets", "folder")):
        with pytest.raises(SpecError, match=words):
            held_out(data, None)
    folder = parse({"data": {"source": [{"kind": "duets", "root": "x"}]}})
    with pytest.raises(SpecError, match="held out"):
        held_out("", folder)


def test_scales_are_those_of_paper_and_release() -> None:
    assert (SCALES["paper"].pool, SCALES["release"].pool) == (32, 96)
    assert isinstance(SCALES["paper"], Protocol)
