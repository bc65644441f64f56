# The types with which Cython compiles pivoting.py.

import cython
from libc cimport math
from libc.stdint cimport int64_t

cdef double inf, ZERO, LARGEST, PARALLEL, TIE, LEVEL, GOLDEN, REACH, NO_STEP, COEFFICIENT, COST
cdef int VIOLATION, FIT, REFRESH, STALLED


cdef class Scratch:
    cdef int64_t[::1] ahead, nonzero
    cdef double[:, ::1] slopes
    cdef double[::1] direction, row, residual, total, multipliers, correction, entering, change, distance, speed


cdef class State:
    cdef readonly object conditions
    cdef public Py_ssize_t count, updates
    cdef Scratch scratch
    cdef int64_t[::1] number, active
    cdef double[:, ::1] a, gradient, inverse
    cdef double[:, :, ::1] cost
    cdef double[::1] value, side, settled, x, dual


cdef class Ball:
    cdef double[:, ::1] metric
    cdef double[::1] center, place, moved
    cdef readonly double radius


# ---- the conditions

@cython.locals(derivative=double)
cpdef double slope(State state, int phase, Py_ssize_t k, double side) noexcept

@cython.locals(change=double)
cdef void put(State state, Py_ssize_t k, double side) noexcept

@cython.locals(a=double[:, ::1], cost=double[:, ::1], side=double[::1])
cpdef append(State state, int64_t[::1] numbers, object rows)

@cython.locals(value=double)
cdef void enter(State state, int64_t i, double[:, ::1] a, double[:, ::1] cost, double[::1] side) noexcept

cpdef void free(State state, Py_ssize_t k) noexcept

cdef double side_of(double value, double side) noexcept

@cython.locals(a=double[:, ::1], sloping=int64_t[::1], slopes=double[::1], total=double, size=Py_ssize_t)
cpdef void sum_gradients(State state) noexcept


# ---- the present vertex

cpdef bint holds(Ball ball, double[::1] x, double reach) noexcept

cdef double move_to(Ball ball, double[::1] x) noexcept

cdef void transform(double[:, ::1] metric, double[::1] v, double[::1] out) noexcept

@cython.locals(
    nonzero=int64_t[::1], size=Py_ssize_t, whole=Py_ssize_t, j=Py_ssize_t, j_2=Py_ssize_t, j_3=Py_ssize_t, j_4=Py_ssize_t,
    d=double, d_2=double, d_3=double, d_4=double,
)
cdef void combine(State state, double[::1] factors, double[:, ::1] matrix, Py_ssize_t count, double[::1] out) noexcept

@cython.locals(x=double[::1], error=double[::1], wrong=double, consistent=bint, hard=bint)
cpdef bint locate(State state, double tolerance) noexcept

@cython.locals(largest=double)
cdef double violation(State state) noexcept


# ---- pivoting

@cython.locals(stays=bint, contradicted=bint, consistent=bint, objective=double, lower_bound=double, smallest=double)
cpdef tuple improve(State state, Ball ball, int weights, double flat, double shift, double tolerance)

cdef void meet(State state) noexcept

@cython.locals(firm=bint, step=double)
cdef bint descend(State state, Ball ball, int phase, bint level, double flat, double shift) noexcept

@cython.locals(slopes=double[:, ::1], flattest=double, highest=double, best=double, merit=double, edge=Py_ssize_t)
cdef Py_ssize_t choose(State state, int phase, bint level, double flat) noexcept

@cython.locals(total=double)
cdef double norm(double[::1] vector) noexcept

cdef void price(State state, int phase, double[::1] slopes) noexcept

@cython.locals(slopes=double[::1], largest=double, smallest=double)
cpdef bint rises(State state, double steep) noexcept

@cython.locals(
    change=double[::1], distance=double[::1], speed=double[::1], ahead=int64_t[::1], size=Py_ssize_t, crossed=Py_ssize_t,
    nearest=Py_ssize_t, k=Py_ssize_t, entering=Py_ssize_t, upwards=double, approach=double, steepness=double, limit=double,
    step=double,
)
cdef double ratio_test(State state, Ball ball, Py_ssize_t edge, int phase, bint firm) noexcept

@cython.locals(ahead=int64_t[::1], distance=double[::1], speed=double[::1])
cdef void swap(State state, Py_ssize_t p, Py_ssize_t q) noexcept

@cython.locals(a=double[:, ::1], inverse=double[:, ::1], row=double[::1], pivot=double, column=double)
cdef void exchange(State state, Py_ssize_t i, Py_ssize_t entering) noexcept

cdef void perturb(State state, double shift) noexcept


# ---- the certificate

@cython.locals(
    objective=double, total=double[::1], y=double[::1], correction=double[::1], clipped=double, lower_bound=double,
    smallest=double,
)
cdef (double, double, double) bounds(State state, int weights) noexcept

cdef void add_active(State state, double[::1] multipliers, double[::1] total) noexcept

@cython.locals(
    bound=double, steepness=double, constant=double, b=double, cost=double, against=double, relief=double
)
cdef double largest_scale(State state, double objective) noexcept


# ---- the rows

@cython.locals(worst=double, row_a=double[:, ::1], row_cost=double[:, ::1], row_side=double[::1])
cpdef double receive(
    State state, object rows, Py_ssize_t first, int64_t group, double[:, ::1] a, double[::1] above, double[::1] below,
    int weights, bint unsettled
) except? -3.0

@cython.locals(
    row_a=double[:, ::1], cost=double[:, ::1], scale=double[::1], side=double[::1], groups=int64_t[::1], worst=double,
    largest=double, peak=double, highest=double,
)
cdef double store(
    object rows, Py_ssize_t first, int64_t group, double[:, ::1] a, double[::1] above, double[::1] below, int weights
) except? -3.0

@cython.locals(power=double)
cdef double power_above(double peak) noexcept

@cython.locals(
    a=double[:, ::1], cost=double[:, ::1], norms=double[::1], sides=double[::1], i=int64_t, value=double, side=double
)
cpdef rank(int64_t[::1] numbers, double[::1] x, object rows, double[::1] distance)

@cython.locals(a=double[:, ::1], cost=double[:, ::1], side=double[::1], i=int64_t, derivative=double)
cpdef add_gradients(int64_t[::1] numbers, object rows, double[::1] total)
