"""Citations: BibTeX of what found the equations."""

from __future__ import annotations

from collections.abc import Iterable

from dynsr import __version__

_DYNSR = """@software{{dynsr,
  title = {{dynsr: the equations of a dynamical system from its trajectories}},
  author = {{{{dynsr contributors}}}},
  version = {{{version}}}
}}"""

_WEILBACH = """@article{weilbach2021inferring,
  title = {Inferring the Structure of Ordinary Differential Equations},
  author = {Weilbach, Juliane and Gerwinn, Sebastian and Weilbach, Christian and Kandemir, Melih},
  journal = {arXiv preprint arXiv:2107.07345},
  year = {2021}
}"""

_FEYNMAN = """@article{udrescu2020feynman,
  title = {{AI} {Feynman}: A physics-inspired method for symbolic regression},
  author = {Udrescu, Silviu-Marian and Tegmark, Max},
  journal = {Science Advances},
  volume = {6},
  number = {16},
  pages = {eaay2631},
  year = {2020},
  doi = {10.1126/sciadv.aay2631}
}"""

_SINDY = """@article{brunton2016discovering,
  title = {Discovering governing equations from data by sparse identification of nonlinear
    dynamical systems},
  author = {Brunton, Steven L. and Proctor, Joshua L. and Kutz, J. Nathan},
  journal = {Proceedings of the National Academy of Sciences},
  volume = {113},
  number = {15},
  pages = {3932--3937},
  year = {2016},
  doi = {10.1073/pnas.1517384113}
}"""

_LENGTH = """@article{rissanen1978modeling,
  title = {Modeling by shortest data description},
  author = {Rissanen, Jorma},
  journal = {Automatica},
  volume = {14},
  number = {5},
  pages = {465--471},
  year = {1978},
  doi = {10.1016/0005-1098(78)90005-5}
}"""

_TSIT5 = """@article{tsitouras2011runge,
  title = {Runge--{Kutta} pairs of order 5(4) satisfying only the first column simplifying
    assumption},
  author = {Tsitouras, Ch.},
  journal = {Computers \\& Mathematics with Applications},
  volume = {62},
  number = {2},
  pages = {770--775},
  year = {2011},
  doi = {10.1016/j.camwa.2011.06.002}
}"""

_JULIA = """@article{rackauckas2017differentialequations,
  title = {{DifferentialEquations.jl} -- A performant and feature-rich ecosystem for solving
    differential equations in {Julia}},
  author = {Rackauckas, Christopher and Nie, Qing},
  journal = {Journal of Open Research Software},
  volume = {5},
  number = {1},
  pages = {15},
  year = {2017},
  doi = {10.5334/jors.151}
}"""

_SYMPY = """@article{meurer2017sympy,
  title = {{SymPy}: symbolic computing in {Python}},
  author = {Meurer, Aaron and others},
  journal = {PeerJ Computer Science},
  volume = {3},
  pages = {e103},
  year = {2017},
  doi = {10.7717/peerj-cs.103}
}"""

_OF_METHODS = {
    "dynaifeynman": (_WEILBACH, _FEYNMAN),
    "ga": (_WEILBACH,),
    "sindy": (_SINDY,),
}


def write_citations(methods: Iterable[str], engine: str = "embedded", is_map: bool = False) -> str:
    """Write BibTeX of dynsr, of the methods that ran, of the score and of what integrated.

    Parameters
    ----------
    methods : names of the methods.
    engine : "embedded" or "julia".
    is_map : whether nothing was integrated.

    >>> print(write_citations(["sindy"])[:16])
    @software{dynsr,
    """
    entries = [_DYNSR.format(version=__version__)]
    entries += [entry for name in methods for entry in _OF_METHODS.get(name, ())]
    entries += [_LENGTH, _SYMPY]
    if not is_map:
        entries += [_TSIT5, *([_JULIA] if engine == "julia" else [])]
    return "\n\n".join(dict.fromkeys(entries)) + "\n"
