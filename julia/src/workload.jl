# What is compiled and kept when this package is installed: an integration, and every kind of
# regression, on tiny problems. `compile` is not among it, since no text may be evaluated into a
# module while its package is compiled; the solver's own code is the same for every right-hand side.
using PrecompileTools: @compile_workload

function decay!(du, u, p, t)
    du[1] = -u[1]
    return nothing
end

function work_integration()
    return run_tsit5(Slopes(decay!), [1.0], [0.0, 0.5, 1.0], 1.0e-6, 1.0e-9, 1000, 60.0)
end

function driven!(du, u, p, t)
    du[1] = Formulas.drive(p, 1, t) - u[1]
    return nothing
end

function work_driven()
    return run_driven(
        Slopes(driven!), [1.0], [0.0, 0.5, 1.0], 1.0e-6, 1.0e-9, 1000, 60.0,
        [2.0], [0.0, 0.5], ones(4, 2), [0.5],
    )
end

"Regress dx = 2x / (1 + x), for which both explicit and implicit searches find terms."
function work_regressions()
    x = collect(range(0.1, 2.0; length = 20))
    theta = permutedims([ones(20) x])
    dx = 2 .* x ./ (1 .+ x)
    for optimizer in ("SR3", "ADMM", "STLSQ"), implicit in (false, true)
        for proximal in ("hard", "soft"), weights in ([0.01], [0.01, 0.02])
            work(regress, theta, dx, optimizer, "", weights, 1.0, proximal, false, 10, implicit)
        end
    end
    for optimizer in ("SR3", "ADMM"), implicit in (false, true)
        for release in ("2021", "2021-corrected"), normalize in (false, true)
            work(regress, theta, dx, optimizer, release, [0.01], 1.0, "", normalize, 10, implicit)
        end
    end
    return nothing
end

# What cannot be done ahead is compiled when it is asked for; it must not keep the package from
# being installed.
function work(call, arguments...)
    try
        call(arguments...)
    catch
    end
    return nothing
end

@compile_workload begin
    work(work_integration)
    work(work_driven)
    work(work_regressions)
    work(versions)
end
