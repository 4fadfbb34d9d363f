# Holds `integrate` and `regress` to golden data, without Python. Run it in any project that has
# the dependencies: julia --project=<project> julia/test/runtests.jl
using Test

if Base.find_package("DynSR") === nothing
    include(joinpath(@__DIR__, "..", "src", "DynSR.jl"))
else
    using DynSR: DynSR
end
# Statements of their own: a module just included is seen from the next statement on.
const integrate = DynSR.integrate
const regress = DynSR.regress

const CHECKOUT = joinpath(realpath(@__DIR__), "..", "..")
const GOLDEN = joinpath(CHECKOUT, "tests", "golden", "julia")
const SYSTEMS = ("lotka_volterra", "simple_pendulum", "cart_pole")

const SLOPES = Dict(
    "lotka_volterra" => """
    (du, u, p, t) -> begin
        du[1] = u[1] * (1.5 - u[2])
        du[2] = -u[2] * (3.0 - u[1])
        nothing
    end""",
    "simple_pendulum" => """
    (du, u, p, t) -> begin
        du[1] = u[2]
        du[2] = -0.1 * u[2] - 9.81 * sin(u[1])
        nothing
    end""",
    "cart_pole" => """
    (du, u, p, t) -> begin
        force = -0.2 + 0.5 * sin(6.0 * t)
        s, c = sin(u[1]), cos(u[1])
        du[1] = u[3]
        du[2] = u[4]
        du[3] = -(19.62 * s + s * c * u[3]^2 + force * c) / (2.0 - c^2)
        du[4] = -(s * u[3]^2 + 9.81 * s * c + force) / (2.0 - c^2)
        nothing
    end""",
)

"The numbers of a csv file, one row a line; `skip` lines of header are left out."
function read_numbers(name; skip = 0)
    lines = readlines(joinpath(GOLDEN, name))[(skip + 1):end]
    rows = [parse.(Float64, split(line, ',')) for line in lines if !isempty(line)]
    return permutedims(reduce(hcat, rows))
end

"Library functions (p, m) and forward differences of the last state (m)."
function regression_of(system)
    data = read_numbers("$system.csv"; skip = 1)
    t, states = data[:, 1], data[:, 2:end]
    dx = diff(states[:, end]) ./ diff(t)
    columns = library(Val(Symbol(system)), t[1:(end - 1)], eachcol(states[1:(end - 1), :])...)
    return permutedims(reduce(hcat, columns)), dx
end

function library(::Val{:lotka_volterra}, t, x, y)
    one = fill(1.0, length(t))
    return [x, y, x .* y, sin.(x), sin.(y), cos.(x), cos.(y), one, 1.5 .* x .- x .* y]
end

function library(::Val{:simple_pendulum}, t, a, b)
    one = fill(1.0, length(t))
    return [a, b, sin.(a), cos.(b), cos.(a), sin.(b), cos.(a) .* sin.(b), one]
end

function library(::Val{:cart_pole}, t, w, x, y, z)
    one = fill(1.0, length(t))
    s, c, force = sin.(w), cos.(w), -0.2 .+ 0.5 .* sin.(6 .* t)
    sc = c .* s
    known = -(force .* c .+ 19.62 .* s .+ y .^ 2 .* sc) ./ (2 .- c .^ 2)
    return [
        one, w, x, y, z, y .^ 2, z .^ 2, y .^ 3, z .^ 3, y .^ 4, z .^ 4, s, c, y .* s, z .* s,
        y .^ 2 .* s, z .^ 2 .* s, c .^ 2, sc, y .* sc, z .* sc, y .^ 2 .* sc, z .^ 2 .* sc,
        force, force .* c, force .* s, known,
    ]
end

"One line of sindy.csv as a named tuple."
function record_of(line)
    f = split(line, ',')
    return (
        system = String(f[1]), implicit = f[2] == "implicit", optimizer = String(f[3]),
        release = String(f[4]), weight = parse(Float64, f[5]), relaxation = parse(Float64, f[6]),
        proximal = String(f[7]), normalize = f[8] == "true", cap = parse(Int, f[9]),
        iterations = parse(Int, f[10]), coefficients = parse.(Float64, split(f[11], ';')),
    )
end

# An implicit relation holds up to a factor, which depends on the left-hand side chosen.
function unit(relation)
    size = maximum(abs, relation)
    size == 0 && return relation
    return relation ./ relation[findfirst(x -> abs(x) > 0.999 * size, relation)]
end

@testset "states at tight tolerances are those of Tsit5" begin
    for system in SYSTEMS
        golden = read_numbers("$(system)_train_saveat0.1_tight.csv")
        x, accepted, _, message = integrate(
            SLOPES[system], golden[1, 2:end], golden[:, 1], 1.0e-10, 1.0e-10, 100_000, 60.0,
        )
        @test message == ""
        @test accepted > 100
        @test maximum(abs, x .- golden[:, 2:end]) < 1.0e-8
    end
end

@testset "states at default tolerances are those of Tsit5" begin
    for system in SYSTEMS
        golden = read_numbers("$(system)_test_saveat0.05_default.csv")
        x, _, _, message = integrate(
            SLOPES[system], golden[1, 2:end], golden[:, 1], 1.0e-3, 1.0e-6, 100_000, 60.0,
        )
        @test message == ""
        @test maximum(abs, x .- golden[:, 2:end]) < 2.0e-5
    end
end

@testset "a divergence is a result: NaN from its time on, and a message" begin
    source = "(du, u, p, t) -> begin du[1] = u[1]^2; nothing end"
    x, _, _, message = integrate(source, [1.0], [0.0, 0.5, 2.0], 1.0e-6, 1.0e-9, 10_000, 60.0)
    @test isapprox(x[2, 1], 2.0; rtol = 1.0e-4)
    @test isnan(x[3, 1])
    @test message != ""
end

@testset "leaving the real numbers is a divergence, not an error" begin
    source = "(du, u, p, t) -> begin du[1] = -sqrt(u[1] - 0.5); nothing end"
    x, _, _, message = integrate(source, [0.4], [0.0, 1.0], 1.0e-6, 1.0e-9, 10_000, 60.0)
    @test x[1, 1] == 0.4 && isnan(x[2, 1])
    @test message != ""
end

@testset "every right-hand side has one type, for which the solver is compiled once" begin
    @test isconcretetype(DynSR.Slopes)
    for (source, expected) in (("u[1]", exp(1.0)), ("-2.0 * u[1]", exp(-2.0)))
        slopes = DynSR.Slopes(
            DynSR.compile("(du, u, p, t) -> begin du[1] = $source; nothing end"),
        )
        @test typeof(slopes) === DynSR.Slopes
        x, accepted, rejected, message = Base.invokelatest(
            DynSR.run_tsit5, slopes, [1.0], [0.0, 1.0], 1.0e-10, 1.0e-10, 1000, 60.0,
        )
        @test message == "" && abs(x[2, 1] - expected) < 1.0e-8
        text = "(du, u, p, t) -> begin du[1] = $source; nothing end"
        again = integrate(text, [1.0], [0.0, 1.0], 1.0e-10, 1.0e-10, 1000, 60.0)
        @test again == (x, accepted, rejected, message)
    end
end

@testset "measured inputs are pieces of polynomials, and no step passes over a stop" begin
    # u' = i1 + 2 i2 with i1 = 3t^2 up to 1 and 3 after it, i2 = t: u(2) = 1 + 3 + 4 = 8.
    source = """
    (du, u, p, t) -> begin
        i1 = drive(p, 1, t)
        i2 = drive(p, 2, t)
        du[1] = i1 + 2.0 * i2
        nothing
    end"""
    pieces = [3.0 0.0 0.0; 0.0 0.0 1.0; 0.0 3.0 0.0]
    x, accepted, _, message = DynSR.integrate_driven(
        source, [0.0], [0.0, 1.0, 2.0], 1.0e-10, 1.0e-10, 1000, 60.0,
        [2.0, 1.0], [0.0, 1.0, 0.0], pieces, [0.25, 1.0, 1.75],
    )
    @test message == "" && maximum(abs, x[:, 1] .- [0.0, 2.0, 8.0]) < 1.0e-9
    # A pulse of a hundredth of a second in a hundred seconds of rest, seen for its stops alone.
    pulse = [0.0 100.0 0.0]
    seen = DynSR.integrate_driven(
        "(du, u, p, t) -> begin du[1] = drive(p, 1, t); nothing end", [0.0], [0.0, 100.0],
        1.0e-8, 1.0e-8, 1000, 60.0, [3.0], [0.0, 50.0, 50.01], pulse, [50.0, 50.01],
    )
    @test abs(seen[1][2, 1] - 1.0) < 1.0e-6
end

@testset "limits of steps and of time end a solution" begin
    source = "(du, u, p, t) -> begin du[1] = 50.0 * cos(50.0 * t); nothing end"
    x, accepted, rejected, message =
        integrate(source, [0.0], [0.0, 1000.0], 1.0e-8, 1.0e-8, 100, 60.0)
    @test isnan(x[end, 1]) && accepted + rejected <= 101 && occursin("MaxIters", message)
    x, _, _, message = integrate(source, [0.0], [0.0, 1.0e4], 1.0e-8, 1.0e-8, 10^9, 0.0)
    @test isnan(x[end, 1]) && occursin("not finished within", message)
end

@testset "regressions are those of both releases" begin
    regressions = Dict(system => regression_of(system) for system in SYSTEMS)
    for line in readlines(joinpath(GOLDEN, "sindy.csv"))[2:end]
        record = record_of(line)
        theta, dx = regressions[record.system]
        found, iterations, _ = regress(
            theta, dx, record.optimizer, record.release, [record.weight], record.relaxation,
            record.proximal, record.normalize, record.cap, record.implicit,
        )
        expected = record.coefficients
        if record.implicit
            found, expected = unit(found), unit(expected)
        end
        @test maximum(abs, found .- expected) <= 1.0e-6 * max(maximum(abs, expected), 1.0e-300)
        @test (iterations == -1) == (record.iterations == -1)
    end
end

@testset "the corrected search of 2021 finds a planted rational equation" begin
    x = collect(range(0.1, 2.0; length = 200))
    theta = permutedims([ones(200) x])
    dx = 2 .* x ./ (1 .+ x)
    found, _, _ =
        regress(theta, dx, "SR3", "2021-corrected", [1.0e-8], 1.0, "", false, 20_000, true)
    predicted = -(theta' * found[3:4]) ./ (theta' * found[1:2])
    @test maximum(abs, predicted .- dx) < 1.0e-9
end

@testset "a library function that is zero everywhere harms no other" begin
    x = collect(range(0.1, 2.0; length = 50))
    theta = permutedims([x zeros(50) x .^ 2])
    found, _, _ = regress(theta, 2 .* x, "SR3", "2021", [1.0e-8], 1.0, "", true, 5000, false)
    @test maximum(abs, found .- [2.0, 0.0, 0.0]) < 1.0e-6
end

@testset "ADMM that stands still at its dense start has not converged" begin
    theta, dx = regression_of("lotka_volterra")
    _, iterations, converged =
        regress(theta, dx, "ADMM", "", [0.01], 1.0, "", false, 2000, false)
    @test iterations == 1 && !converged
end

@testset "versions name Julia and the packages" begin
    names = first.(split.(split(DynSR.versions(), '\n'), ' '))
    @test names == ["julia", "OrdinaryDiffEqTsit5", "DataDrivenDiffEq", "DataDrivenSparse"]
end
