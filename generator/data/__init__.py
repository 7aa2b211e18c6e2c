"""Training data: clips from disk or from the choreographer, cached, mixed and cut into batches.

A *source* makes :class:`Clip` s: :class:`InterHuman`, :class:`DuetFolder`, :class:`Choreographed`,
:class:`Exchanged`, :class:`Curated`.
:func:`cached` computes a source once into a memory-mapped file, :func:`measure` takes its
statistics, and :class:`BatchStream` draws batches from one or several. All of it is torch-free.
"""

from generator.data.batches import Batch, BatchConfig, BatchStream
from generator.data.cache import ClipCache, cached
from generator.data.choreographed import Choreographed
from generator.data.clip import Clip, ClipSet, ClipSource, Symmetric, clip_of, resampled
from generator.data.curated import Curated
from generator.data.duets import DuetFolder
from generator.data.exchanged import Exchanged
from generator.data.interhuman import InterHuman
from generator.data.statistics import FeatureStatistics, measure
from generator.data.verdict import Curation, Verdict

__all__ = [
    "Batch",
    "BatchConfig",
    "BatchStream",
    "Choreographed",
    "Clip",
    "ClipCache",
    "ClipSet",
    "ClipSource",
    "Curated",
    "Curation",
    "DuetFolder",
    "Exchanged",
    "FeatureStatistics",
    "InterHuman",
    "Symmetric",
    "Verdict",
    "cached",
    "clip_of",
    "measure",
    "resampled",
]
