"""Sentences on their way into training: remembered exactly, and read token by token."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from generator.architecture import DenoiserConfig
from generator.denoiser import Denoiser, TextReader
from generator.text.encoder import TokenEncoder
from generator.training import texts
from generator.training.texts import TextTable
from robots.errors import SpecError

torch.set_num_threads(1)
TOKENS, WIDTH = 5, 6


class Counted:
    """An encoder that counts; the length of a sentence says how many of its numbers are not 0."""

    def __init__(self, fine: bool):
        self.calls, self._fine = 0, fine

    def encode(self, sentences):
        self.calls += len(sentences)
        out = np.zeros((len(sentences), 30), np.float32)
        for row, sentence in zip(out, sentences, strict=True):
            rng = np.random.default_rng(len(sentence))
            row[: len(sentence)] = rng.standard_normal(len(sentence))
            if not self._fine:
                row[:] = row.astype(np.float16)
        return out


@pytest.mark.parametrize("fine", [False, True])
def test_remembered_vectors_are_the_encoder_s_to_the_last_bit(fine):
    encoder = Counted(fine)
    table = TextTable(encoder)
    sentences = ["", "a wave", "they bow slowly", "a wave"]
    for _ in range(2):
        np.testing.assert_array_equal(table.vectors(sentences), Counted(fine).encode(sentences))
    assert encoder.calls == 3


def test_a_table_that_is_full_begins_anew(monkeypatch):
    monkeypatch.setattr(texts, "MOST", 100)
    encoder = Counted(True)
    table = TextTable(encoder)
    sentences = ["x" * n for n in range(1, 30)]
    for sentence in sentences:
        np.testing.assert_array_equal(table.vectors([sentence]), Counted(True).encode([sentence]))
        assert table._bytes <= 100 + 4 * 30
    before = encoder.calls
    table.vectors(sentences[:1])
    assert encoder.calls == before + 1


class Shipped(TokenEncoder):
    """An encoder of the kind that is kept on disk."""

    def __init__(self):
        self.counted = Counted(fine=False)

    @property
    def fingerprint(self):
        return "test"

    def encode(self, sentences):
        return self.counted.encode(sentences)


def test_a_second_run_reads_the_vectors_that_the_first_one_left(tmp_path):
    sentences = ["a wave", "they bow slowly", ""]
    first, second = Shipped(), Shipped()
    made = TextTable(first, tmp_path).vectors(sentences)
    np.testing.assert_array_equal(TextTable(second, tmp_path).vectors(sentences), made)
    assert (first.counted.calls, second.counted.calls) == (3, 0)


def test_vectors_on_a_damaged_disk_are_computed_again(tmp_path, caplog):
    TextTable(Shipped(), tmp_path).vectors(["a wave"])
    (file,) = tmp_path.glob("*.sqlite")
    for part in tmp_path.iterdir():
        part.unlink()
    file.write_bytes(b"this is no database" * 100)
    encoder = Shipped()
    vectors = TextTable(encoder, tmp_path).vectors(["a wave"])
    np.testing.assert_array_equal(vectors, Counted(False).encode(["a wave"]))
    assert "not kept" in caplog.text


def test_two_threads_may_ask_one_table(tmp_path):
    table, sentences = TextTable(Shipped(), tmp_path), ["x" * n for n in range(30)]
    expected = Counted(False).encode(sentences)
    with ThreadPoolExecutor(4) as pool:
        for vectors in pool.map(table.vectors, [sentences] * 8):
            np.testing.assert_array_equal(vectors, expected)


def reader(**changes) -> DenoiserConfig:
    sizes = {"width": 16, "layers": 1, "heads": 2, "feedforward": 16, "dropout": 0.0}
    text = {"text_width": TOKENS * WIDTH, "text_tokens": TOKENS}
    return DenoiserConfig(**{**sizes, **text, **changes})


@torch.no_grad()
def test_the_order_of_tokens_counts_and_their_neighbours_in_the_batch_do_not():
    torch.manual_seed(0)
    module = TextReader(reader()).eval()
    for parameter in module.parameters():
        if parameter.dim() > 1:
            parameter.normal_(std=0.3)
    tokens = torch.randn(3, TOKENS, WIDTH)
    tokens[0, 3:] = tokens[1, 2:] = 0
    tokens[2] = 0
    nobody = torch.zeros(1, 16)
    together = module(tokens.flatten(1)[None], nobody)[0]
    for one, row in zip(tokens, together, strict=True):
        torch.testing.assert_close(module(one.flatten()[None, None], nobody)[0, 0], row)
    turned = tokens[:1].clone()
    turned[0, :3] = tokens[0, [2, 1, 0]]
    assert (module(turned.flatten(1)[None], nobody)[0, 0] - together[0]).abs().max() > 0.01
    torch.testing.assert_close(together[2], module.out.bias)
    first, second = module(tokens[:1].flatten(1).expand(2, -1, -1), torch.randn(2, 16))
    assert (first - second).abs().max() > 0.01


def test_what_reads_the_tokens_learns():
    torch.manual_seed(0)
    net = Denoiser(reader())
    for parameter in net.networks[0].out.parameters():
        torch.nn.init.normal_(parameter)
    for block in net.networks[0].blocks:
        torch.nn.init.normal_(block.modulation.weight, std=0.1)
    x, t = torch.randn(2, 4, 524), torch.tensor([3, 700])
    cond = torch.randn(2, TOKENS * WIDTH)
    net(x, t, cond).square().mean().backward()
    words = net.networks[0].embed_text
    # The last linears of the feed-forward layers start at zero, and so learn first.
    for name, parameter in words.named_parameters():
        if ".inner." not in name and "norms.1" not in name and "norms.3" not in name:
            assert parameter.grad is not None, name
            assert parameter.grad.abs().max() > 0, name


def test_tokens_that_do_not_fit_are_refused():
    with pytest.raises(SpecError, match="7 tokens"):
        reader(text_tokens=7)
    with pytest.raises(SpecError, match="text_layers"):
        reader(text_layers=-1)
