# SR3, ADMM and the implicit search as DataDrivenDiffEq.jl 0.5 ran them in spring 2021.

"""
    Optimizer2021(name, weight, relaxation)

`name` is "SR3" or "ADMM", `weight` lambda, and `relaxation` nu (SR3) or rho (ADMM).
"""
struct Optimizer2021
    name::String
    weight::Float64
    relaxation::Float64
end

"The magnitude below which a (normalised) coefficient becomes zero."
function threshold(optimizer::Optimizer2021)
    if optimizer.name == "SR3"
        return sqrt(2 * optimizer.weight / optimizer.relaxation)
    end
    return optimizer.weight / optimizer.relaxation
end

soften(x, width) = sign(x) * max(abs(x) - width, zero(x))

"""
    sr3(gram, right, start, optimizer, cap) -> (x, iterations, converged)

`x = (A'A + I/nu)^-1 (A'y + w/nu)`, `w = soft(x, tau nu lambda)`, from `w = start` until `w`
moves by less than the machine epsilon. `gram` is `A'A`, `right` is `A'y`.
"""
function sr3(gram, right, start, optimizer, cap)
    nu = optimizer.relaxation
    width = threshold(optimizer) * nu * optimizer.weight
    inverse = inv(Symmetric(gram + I / nu))
    w, x, following = copy(start), similar(start), similar(start)
    for iteration in 1:cap
        mul!(x, inverse, right .+ w ./ nu)
        following .= soften.(x, width)
        moved = norm(w .- following) / nu
        w .= following
        moved < eps() && return x, iteration, true
    end
    return x, cap, false
end

"""
    admm(gram, right, start, optimizer, cap) -> (x, iterations, converged)

`z = (A'A + rho I)^-1 (A'y + rho x - u)`, `x = soft(z + u/rho, tau)`, `u += rho (z - x)`, from
`x = start` and `u = 0` until `x` moves by less than the machine epsilon.
"""
function admm(gram, right, start, optimizer, cap)
    rho, width = optimizer.relaxation, threshold(optimizer)
    inverse = inv(Symmetric(gram + rho * I))
    fixed = inverse * right
    x, dual, z, following = copy(start), zero(start), similar(start), similar(start)
    for iteration in 1:cap
        mul!(z, inverse, rho .* x .- dual)
        z .+= fixed
        following .= soften.(z .+ dual ./ rho, width)
        dual .+= rho .* (z .- following)
        moved = norm(x .- following)
        x .= following
        moved < eps() && return x, iteration, true
    end
    return x, cap, false
end

"2-norm of each row; 1 for a row of zeros, which no division can help."
function row_norms(rows)
    norms = vec(sqrt.(sum(abs2, rows; dims = 2)))
    return ifelse.(norms .> 0, norms, 1.0)
end

"""
    solve2021(rows, target, gram, right, optimizer, normalize, cap)
        -> (coefficients, iterations, converged)

Regress `target` (m) on `rows` (p, m), whose Gram matrix and products with the target are given.
With `normalize` the rows have norm one during the solve, so that thresholds act on scaled
coefficients.
"""
function solve2021(rows, target, gram, right, optimizer, normalize, cap)
    scale = normalize ? row_norms(rows) : ones(size(rows, 1))
    start = qr(permutedims(rows ./ scale), ColumnNorm()) \ target
    descend = optimizer.name == "SR3" ? sr3 : admm
    x, iterations, converged =
        descend(gram ./ (scale .* scale'), right ./ scale, start, optimizer, cap)
    x[abs.(x) .< threshold(optimizer)] .= 0
    return x ./ scale, iterations, converged
end

"""
    explicit2021(theta, dx, optimizer, normalize, cap) -> (coefficients, iterations, converged)
"""
function explicit2021(theta, dx, optimizer, normalize, cap)
    return solve2021(theta, dx, theta * theta', theta * dx, optimizer, normalize, cap)
end

struct Candidate2021
    relation::Vector{Float64}
    iterations::Int
    converged::Bool
    skipped::Bool
end

"""
    implicit2021(theta, dx, optimizers, normalize, cap, corrected)
        -> (coefficients, iterations, converged)

Search `q` (2p) with `[dx .* theta'; theta]' q = 0`. Every row in turn has coefficient one and
the others are solved for, with every optimizer. `iterations` is -1 when nothing was found.
`corrected` takes the best candidate of all; otherwise the release's own choice is repeated.
"""
function implicit2021(theta, dx, optimizers, normalize, cap, corrected)
    rows = vcat(dx' .* theta, theta)
    gram = rows * rows'
    p = size(theta, 1)
    candidates = Candidate2021[]
    for fixed in 1:(2p), optimizer in optimizers
        others = setdiff(1:(2p), fixed)
        x, iterations, converged = solve2021(
            rows[others, :], -rows[fixed, :], gram[others, others], -gram[others, fixed],
            optimizer, normalize, cap,
        )
        relation = zeros(2p)
        relation[fixed] = 1
        relation[others] = x
        skipped = iszero(relation[1:p]) || iszero(relation[(p + 1):end])
        push!(candidates, Candidate2021(relation, iterations, converged, skipped))
    end
    return corrected ? choose_best(candidates, rows) : choose2021(candidates, rows)
end

score(relation, rows) = hypot(count(!iszero, relation), norm(rows' * relation))

scaled(relation) = relation ./ maximum(abs, relation)

nothing_found(rows) = (zeros(size(rows, 1)), -1, false)

# The incumbent starts as the zero vector, which scores 0, so that only the first candidate can
# replace it, being taken unasked. Later ones compete at their own scale with the incumbent at
# largest magnitude one. The count told is the smallest of all that were ever accepted.
function choose2021(candidates, rows)
    best, bound, accepted = nothing, 0.0, Candidate2021[]
    for (position, candidate) in enumerate(candidates)
        candidate.skipped && continue
        if position == 1 || score(candidate.relation, rows) < bound
            best = scaled(candidate.relation)
            bound = score(best, rows)
            push!(accepted, candidate)
        end
    end
    best === nothing && return nothing_found(rows)
    return best, minimum(c.iterations for c in accepted), last(accepted).converged
end

# Every candidate at largest magnitude one; of equals the first.
function choose_best(candidates, rows)
    found = filter(candidate -> !candidate.skipped, candidates)
    isempty(found) && return nothing_found(rows)
    best = found[argmin([score(scaled(c.relation), rows) for c in found])]
    return scaled(best.relation), best.iterations, best.converged
end
