"""Start: the formulas of an earlier discovery, from which a search on more data starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import sympy

from dynsr.data import Trajectory
from dynsr.discovery.orders import Form
from dynsr.discovery.records import RECORD
from dynsr.discovery.result import Discovery
from dynsr.errors import InputError, quoted
from dynsr.expression import parse, to_text
from dynsr.jobs import fingerprint
from dynsr.parameters import refuse_curves

SOURCE = "the earlier discovery"


@dataclass(frozen=True)
class Start:
    """Whole right-hand sides that an earlier discovery found.

    Parameters
    ----------
    equations : state -> the equation that it chose.
    front : state -> all that it found, from simple to accurate.
    discrete : whether they are a map.
    label : what the earlier discovery is called in messages.
    """

    equations: Mapping[str, sympy.Expr]
    front: Mapping[str, tuple[sympy.Expr, ...]]
    discrete: bool
    label: str

    @classmethod
    def read(cls, given: Discovery | Start | str | Path) -> Start:
        """Take a discovery, the file that it was saved to, or the folder of the file.

        Raises InputError, one line, when it is neither.
        """
        if isinstance(given, Start):
            return given
        label = "start"
        if isinstance(given, (str, Path)):
            path = Path(given)
            label = f"start {str(given)!r}"
            if path.is_dir() and not (path / RECORD).exists():
                raise InputError(
                    f"{label} is a folder without {RECORD}: its discovery has not ended; run it "
                    "again, or give the file of another one"
                )
            given = Discovery.load(path / RECORD if path.is_dir() else path)
        if not isinstance(given, Discovery):
            raise InputError(
                f"start {quoted(given)} must be a Discovery, or the file that one was saved to"
            )
        refuse_curves(given.free, "a search starts from formulas")
        known = given.settings.get("known")
        parts = dict(known) if isinstance(known, Mapping) else {}
        # An equation with a free function is whole.
        parts |= dict.fromkeys(given.free.states, "0")
        shares = {s: parse(str(parts.get(s, "0"))) for s in given.equations}
        front = {
            s: tuple(shares[s] + c.expr for c in given.front.get(s, ())) for s in given.equations
        }
        return cls(dict(given.equations), front, given.is_map, label)

    def check(self, run: Trajectory, form: Form) -> Start:
        """Give it back; raises InputError where it is of other columns or another kind.

        Parameters
        ----------
        run : a trajectory of the new data, with its velocities.
        form : order, time and kind of the equations that are sought.
        """
        if self.discrete != form.discrete:
            kinds = ("equations of slopes", "a map")
            raise InputError(
                f"{self.label} found {kinds[self.discrete]}, but here one asks for "
                f"{kinds[form.discrete]}; ask for the same, or leave start out"
            )
        names = {*run.names, *(["t"] if form.explicit_time else [])}
        exprs = [*self.equations.values(), *(e for own in self.front.values() for e in own)]
        used = {*self.equations, *(str(s) for e in exprs for s in e.free_symbols)}
        strange = sorted({*(used - names), *({*self.equations} - {*run.states})})
        if strange:
            raise InputError(
                f"{self.label} has {strange[0]!r} in its equations, which these data do not have "
                f"so; they have the states {', '.join(run.states)}"
                + (f" and the inputs {', '.join(run.input_names)}" if run.input_names else "")
                + "; give data of the same columns and kind"
            )
        return self

    def formulas(self, state: str, known: sympy.Expr) -> tuple[sympy.Expr, ...]:
        """Give the formulas of a state without a given part, the chosen one first.

        Parameters
        ----------
        state : whose equation is searched.
        known : the part of it that is given now.
        """
        whole = [*([self.equations[state]] if state in self.equations else [])]
        whole += self.front.get(state, ())
        return tuple(dict.fromkeys(e - known for e in whole))

    def rewrite(self, change: Callable[[str, sympy.Expr], sympy.Expr]) -> Start:
        """Give the same with every right-hand side changed.

        Parameters
        ----------
        change : gives, for a state and a right-hand side, another one.
        """
        return replace(
            self,
            equations={s: change(s, e) for s, e in self.equations.items()},
            front={s: tuple(change(s, e) for e in own) for s, own in self.front.items()},
        )

    @property
    def record(self) -> dict[str, object]:
        """What a record keeps of it: the equations, and a digest of all formulas."""
        texts = {s: [to_text(e) for e in own] for s, own in self.front.items()}
        equations = {s: to_text(e) for s, e in self.equations.items()}
        return {"equations": equations, "digest": fingerprint(equations, texts)[:16]}
