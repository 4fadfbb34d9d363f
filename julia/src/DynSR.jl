"""
    DynSR

The Julia engine of dynsr: `integrate` solves an initial value problem by OrdinaryDiffEq's
Tsit5, `regress` a sparse regression, as DataDrivenDiffEq.jl did it in 2021 or as
DataDrivenSparse.jl does it today. Plain arrays, numbers and strings go in and come out.
"""
module DynSR

using DataDrivenDiffEq: DataDrivenDiffEq
using DataDrivenSparse: DataDrivenSparse
using LinearAlgebra: ColumnNorm, I, Symmetric, mul!, norm, qr
using OrdinaryDiffEqTsit5: OrdinaryDiffEqTsit5, DiscreteCallback, ODEProblem, ReturnCode,
    Tsit5, solve, terminate!

include("integrate.jl")
include("release2021.jl")
include("regress.jl")

export integrate, regress

"""
    versions() -> String

Julia and the packages that take part in an answer, one `name version` a line.
"""
function versions()
    packages = (OrdinaryDiffEqTsit5, DataDrivenDiffEq, DataDrivenSparse)
    lines = ["$(nameof(package)) $(pkgversion(package))" for package in packages]
    return join(["julia $VERSION"; lines], "\n")
end

# A project that is not ours includes this file, and need not hold PrecompileTools.
if Base.PkgId(@__MODULE__).uuid !== nothing
    include("workload.jl")
end

end
