"""From the residual of a recording to a physical effect that the model lacks.

:mod:`pipeline` runs five steps. Their modules, in the order in which they run:

1. Prepare. :mod:`preparation` makes experiments of the recordings and groups them.
2. Recalibrate. :mod:`splits` says what is held out and fits the base parameters of each group; a model of all of its
   recordings is a ``Model`` (:mod:`models`). :mod:`agreement` refuses recordings of different rigs.
3. Search. :mod:`search` asks each of the :mod:`hypotheses` what it would make of the model, and takes the best answer:
   an effect of the catalogue, or one of the :mod:`calibrations`, zeros, scales and late stamps.
4. Judge. :mod:`judgement` has the rules of the verdict on a group, in one table; :mod:`verdicts` has their names. Some
   of the rules ask a hypothesis more: an effect that begins or ends during a recording (:mod:`onset`, by
   :mod:`change_point`), an effect that base parameters imitate (:mod:`disguise`), a torque that comes and goes
   (:mod:`disturbance`), friction of a joint that sticks.
   :mod:`findings` names the effects, with muscle and size, and :mod:`splits` says how firm they are.
5. Describe, once and after the last learned law. :mod:`description` makes the :class:`Diagnosis`: :mod:`held_out` its
   errors, :mod:`ambiguity` its rivals, :mod:`remaining` and :mod:`residual_statistics` what is left, :mod:`warnings`
   what a user should know, :mod:`rig_choice` the rig files, :mod:`intervals` the width of their intervals, and
   :mod:`sentences` the result in words. :mod:`closed_loop` is the diagnosis with its inputs and ``report.json``.

All of them use :mod:`thresholds`. :mod:`judged`, :mod:`result` and :mod:`errors` hold the data that are passed on.

A regulator-driven joint with many short episodes has a pipeline of its own: :mod:`episodes`, with
:mod:`pam_antagonist.inference.episode_search` for its effects. A rig of data sheets, and short trials of any valves,
differ in what is prepared and what is concluded: :mod:`from_pressures` identifies the rig, and :mod:`model_parts` makes
an experiment of each of its parts. Search, rules and result are the same.

Where the catalogue leaves a clear excess, :mod:`learned_law` measures the laws that are missing. :mod:`law_search`
finds one, or two at once, by derivatives of the model (:mod:`law_columns`). :mod:`law_forms` says what a law may be,
:mod:`law_arguments` what it may depend on, :mod:`law_evidence` whether it is worth taking, and :mod:`law_findings` what
is said of it.

:mod:`monitor` tests a running joint: :mod:`monitor_responses` is what each hypothesis would change in the innovations,
:mod:`monitor_blocks` the evidence for it and for its onset.
"""

from pam_antagonist.diagnosis.pipeline import diagnose
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect

__all__ = ["Diagnosis", "FoundEffect", "diagnose"]
