// After `typedef ... Real`: vectors in the precision of the springs and in float64, and what a contact does to a point.

struct alignas(2 * sizeof(Real)) Pair { Real x, y; };
struct alignas(16) Place { double x, y; };
struct Push { Pair normal, friction; };
