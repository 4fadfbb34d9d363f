"""
    Formulas

Where right-hand sides are compiled. The functions below shadow Julia's own, which throw where
they have no real value; a solver needs NaN there, to retry with a shorter step or to give up.
"""
module Formulas

not_a_number(x) = oftype(float(x), NaN)

for name in (:sin, :cos, :tan)
    @eval $name(x) = isfinite(x) ? Base.$name(x) : not_a_number(x)
end
for name in (:asin, :acos)
    @eval $name(x) = abs(x) <= 1 ? Base.$name(x) : not_a_number(x)
end
for name in (:sqrt, :log)
    @eval $name(x) = x >= 0 ? Base.$name(x) : not_a_number(x)
end
power(x, y) = x >= 0 || isinteger(y) ? x^y : not_a_number(x)

"Value at time `t` of the measured input number `k`, by the piece that began last."
function drive(p, k, t)
    starts, pieces = p.starts[k], p.pieces[k]
    i = clamp(searchsortedlast(starts, t), 1, length(starts))
    past, value = t - starts[i], zero(t)
    for row in axes(pieces, 1)
        value = value * past + pieces[row, i]
    end
    return value
end

end

const COMPILED = Dict{String, Function}()

"""
    compile(source) -> Function

Compile the text of a function `(du, u, p, t) -> ...`; the same text gives the same function.
"""
function compile(source::AbstractString)
    return get!(COMPILED, String(source)) do
        Core.eval(Formulas, Meta.parse(source))
    end
end

"""
    Slopes(call)

A right-hand side `(du, u, p, t) -> ...`. Every one has this same type, so that the solver is
compiled once and not anew for each; what that costs is one dynamic call a slope.
"""
struct Slopes
    call::Function
end

function (slopes::Slopes)(du, u, p, t)
    slopes.call(du, u, p, t)
    return nothing
end

"""
    integrate(source, x0, t, reltol, abstol, max_steps, max_seconds)
        -> (x, accepted, rejected, message)

Solve `dx/dt = f(x, t)` by Tsit5 from `x0` at `t[1]` and give `x` (n, k) at all n times `t`.

`source` is the text of `(du, u, p, t) -> ...`, which writes the k slopes at state `u` and time
`t` into `du`. `x` is NaN from the time on where the solver gave up, and `message` then says
why; it is empty when the end was reached. Step sizes follow the PI controller with a growth of
at most ten, also after the first step, for which later releases of OrdinaryDiffEq allow more.
"""
function integrate(source, x0, t, reltol, abstol, max_steps, max_seconds)
    slopes = Slopes(compile(source))
    # What was just compiled can only be called from a newer world than this method's.
    return Base.invokelatest(
        run_tsit5, slopes, Vector{Float64}(x0), Vector{Float64}(t),
        Float64(reltol), Float64(abstol), Int(max_steps), Float64(max_seconds),
    )
end

"""
    Drives(starts, pieces)

Measured inputs: input `k` is the polynomial in `t - starts[k][i]` with the coefficients
`pieces[k][:, i]`, the highest power first, from `starts[k][i]` to the next start.
"""
struct Drives
    starts::Vector{Vector{Float64}}
    pieces::Vector{Matrix{Float64}}
end

"""
    integrate_driven(source, x0, t, reltol, abstol, max_steps, max_seconds, counts, starts,
        pieces, stops) -> (x, accepted, rejected, message)

Solve as `integrate` does, with measured inputs and times that no step passes over.

`source` takes input `k` as `drive(p, k, t)`. `counts` says how many pieces each input has,
`starts` (m) where all of them begin, one input after the other, `pieces` (c, m) what they are,
and `stops` holds the times, all inside the span.
"""
function integrate_driven(
        source, x0, t, reltol, abstol, max_steps, max_seconds, counts, starts, pieces, stops,
    )
    slopes = Slopes(compile(source))
    return Base.invokelatest(
        run_driven, slopes, Vector{Float64}(x0), Vector{Float64}(t),
        Float64(reltol), Float64(abstol), Int(max_steps), Float64(max_seconds),
        Vector{Float64}(counts), Vector{Float64}(starts), Matrix{Float64}(pieces),
        Vector{Float64}(stops),
    )
end

"All of `integrate_driven` but what makes Julia's own arrays and compiles the slopes."
function run_driven(
        slopes, x0, t, reltol, abstol, max_steps, max_seconds, counts, starts, pieces, stops,
    )
    drives = drives_of(counts, starts, pieces)
    return run_tsit5(
        slopes, x0, t, reltol, abstol, max_steps, max_seconds, drives, stops,
    )
end

"Take apart what came as one array of each kind."
function drives_of(counts, starts, pieces)
    ends = cumsum(Int.(counts))
    spans = [(stop - count + 1):stop for (stop, count) in zip(ends, Int.(counts))]
    return Drives([starts[span] for span in spans], [pieces[:, span] for span in spans])
end

function run_tsit5(
        slopes, x0, t, reltol, abstol, max_steps, max_seconds, drives = nothing, stops = nothing,
    )
    algorithm = Tsit5()
    options = (;
        saveat = t, save_start = true, save_end = true, save_everystep = false, dense = false,
        reltol, abstol, maxiters = max_steps, callback = clock(max_seconds),
    )
    controller = first_step_controller(algorithm)
    if controller !== nothing
        options = (; options..., controller)
    end
    if stops !== nothing
        options = (; options..., tstops = stops)
    end
    parameters = drives === nothing ? () : (drives,)
    problem = ODEProblem(slopes, x0, (first(t), last(t)), parameters...)
    # A divergence is told by the result; the solver's warnings would only repeat it.
    solution = Base.CoreLogging.with_logger(Base.CoreLogging.NullLogger()) do
        solve(problem, algorithm; options...)
    end
    return answer_at(t, solution, max_seconds)
end

"""
    answer_at(t, solution, max_seconds) -> (x, accepted, rejected, message)

What `integrate` answers, from a solution by any solver of DifferentialEquations.
"""
function answer_at(t, solution, max_seconds)
    return (
        rows_at(t, solution, length(first(solution.u))), Int(solution.stats.naccept),
        Int(solution.stats.nreject), ending(solution, max_seconds),
    )
end

"""
    clock(max_seconds)

A callback that ends the solution `max_seconds` after its first step, which compiles the
slopes; it changes no step.
"""
function clock(max_seconds)
    deadline = Ref(Inf)
    function late(u, t, integrator)
        if deadline[] == Inf
            deadline[] = time() + max_seconds
        end
        return time() > deadline[]
    end
    stop!(integrator) = terminate!(integrator, ReturnCode.MaxTime)
    return DiscreteCallback(late, stop!; save_positions = (false, false))
end

"""
    first_step_controller(algorithm)

The PI controller that limits the growth after the first step to ten, or `nothing` where the
solver's own does: releases before that limit was raised to 10000 have no such option.
"""
function first_step_controller(algorithm)
    core = parentmodule(OrdinaryDiffEqTsit5.alg_cache)
    for name in (:NewPIController, :PIController)
        isdefined(core, name) || continue
        controller = getfield(core, name)
        try
            return controller(Float64, algorithm; qmax_first_step = 10.0)
        catch problem
            problem isa MethodError || rethrow()
        end
    end
    return nothing
end

"States at the times asked for; a solution that ended early may hold one more time of its own."
function rows_at(t, solution, k)
    x = fill(NaN, length(t), k)
    row = 1
    for (time, state) in zip(solution.t, solution.u)
        while row <= length(t) && t[row] < time
            row += 1
        end
        row <= length(t) && all(isfinite, state) || break
        if t[row] == time
            x[row, :] .= state
        end
    end
    return x
end

function ending(solution, max_seconds)
    code, stop = solution.retcode, last(solution.t)
    code == ReturnCode.Success && return ""
    code == ReturnCode.MaxTime && return "not finished within $max_seconds s, at t = $stop"
    return "Tsit5 ended with $code at t = $stop"
end
