# Today's stop: sqrt(eps), for absolute and relative moves alike.
const MOVE = sqrt(eps())
const ADMM_GAP = 1.0e-4

"""
    regress(theta, dx, optimizer, release, weights, relaxation, proximal, normalize,
        max_iterations, implicit) -> (coefficients, iterations, converged)

Find few coefficients `c` with `dx = c . theta`, or (`implicit`) `q` with
`[dx .* theta'; theta]' q = 0`.

`theta` (p, m) holds p library functions at m samples, `dx` (m) the derivative. `optimizer` is
"SR3", "ADMM" or "STLSQ"; `release` "2021", "2021-corrected", or "" for DataDrivenSparse.jl as
installed. `weights` are lambda (2021) or the thresholds (today), `relaxation` is nu or rho,
`proximal` "hard" or "soft" (SR3 today), `normalize` acts in 2021 only. `coefficients` has p
numbers, or 2p for an implicit problem, the denominator's first; `iterations` is -1 when an
implicit search found nothing.
"""
function regress(
        theta, dx, optimizer, release, weights, relaxation, proximal, normalize,
        max_iterations, implicit,
    )
    functions, slopes = Matrix{Float64}(theta), Vector{Float64}(dx)
    ascending = sort(Vector{Float64}(weights))
    cap = Int(max_iterations)
    if release == ""
        algorithm = algorithm_of(optimizer, ascending, Float64(relaxation), proximal)
        return (implicit ? implicit_today : explicit_today)(functions, slopes, algorithm, cap)
    end
    optimizers = [Optimizer2021(optimizer, w, relaxation) for w in Vector{Float64}(weights)]
    if implicit
        corrected = release == "2021-corrected"
        return implicit2021(functions, slopes, optimizers, normalize, cap, corrected)
    end
    return explicit2021(functions, slopes, only(optimizers), normalize, cap)
end

"The optimizer of DataDrivenSparse.jl; its `threshold` is a number where there is but one."
function algorithm_of(name, thresholds, relaxation, proximal)
    threshold = length(thresholds) == 1 ? only(thresholds) : thresholds
    if name == "SR3"
        soft = proximal == "soft"
        operator = soft ? DataDrivenSparse.SoftThreshold() : DataDrivenSparse.HardThreshold()
        return DataDrivenSparse.SR3(threshold, relaxation, operator)
    end
    name == "ADMM" && return DataDrivenSparse.ADMM(threshold, relaxation)
    name == "STLSQ" && return DataDrivenSparse.STLSQ(threshold, relaxation)
    throw(ArgumentError("unknown optimizer $name; the optimizers are SR3, ADMM and STLSQ"))
end

function options_today(cap)
    return DataDrivenDiffEq.DataDrivenCommonOptions(;
        maxiters = cap, abstol = MOVE, reltol = MOVE, selector = DataDrivenDiffEq.bic,
    )
end

function explicit_today(theta, dx, algorithm, cap)
    solver = DataDrivenSparse.SparseLinearSolver(algorithm; options = options_today(cap))
    cache, _, iterations = solver(theta, dx)
    return vec(DataDrivenSparse.coef(cache)), iterations, settles(algorithm, theta, dx, cap)
end

function implicit_today(theta, dx, algorithm, cap)
    rows = vcat(dx' .* theta, theta)
    p = size(theta, 1)
    search = DataDrivenSparse.ImplicitOptimizer(algorithm)
    relation, iterations = try
        denominator = [fill(true, p); fill(false, p)]
        found = search(rows, dx'; options = options_today(cap), necessary_idx = denominator)
        vec(found[1]), found[3]
    catch problem
        # When no candidate has two terms, the search still asks for the one numbered 0.
        problem isa BoundsError && all(iszero, problem.i) || rethrow()
        return zeros(2p), -1, false
    end
    fixed = findfirst(==(-1), relation)
    others = setdiff(1:(2p), fixed)
    converged = settles(algorithm, rows[others, :], rows[fixed, :], cap)
    return relation, iterations, converged
end

"""
    settles(algorithm, rows, target, cap) -> Bool

Whether the optimizer comes to rest, by repeating its steps: the package itself always reports
success. ADMM may stand still at its dense start, so that its two copies of the coefficients
must agree too (the primal residual of Boyd et al. 2011, section 3.3.1).
"""
function settles(algorithm, rows, target, cap)
    cache = DataDrivenSparse.init_cache(algorithm, rows, target)
    rests = false
    for threshold in DataDrivenSparse.get_thresholds(algorithm)
        rests = false
        for _ in 1:cap
            dual = algorithm isa DataDrivenSparse.ADMM ? copy(cache.w) : nothing
            DataDrivenSparse.step!(cache, threshold)
            if stands_still(cache)
                rests = dual === nothing || copies_agree(cache, dual)
                break
            end
        end
    end
    return rests
end

function stands_still(cache)
    moved = norm(cache.X .- cache.X_prev)
    return !any(cache.active_set) || moved < MOVE || moved < MOVE * norm(cache.X)
end

# One step adds to the dual by how much the copies differ, before small entries are cut.
function copies_agree(cache, dual)
    return norm(cache.w .- dual) <= ADMM_GAP * max(norm(cache.X), norm(cache.alpha))
end
