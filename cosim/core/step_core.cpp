// Whole driven steps on libsumo's C++ interface: decide, command, step, read, look whether anything happened.
//
// This is the compiled form of cosim/loop/driving.py for the usual case, in which nothing happens in a step: no
// contact, no ending, no vehicle missing. A step in which something may have happened is the last one of a call; Python
// judges it. So this file decides nothing. All arithmetic that reaches a result is done in the same order and precision
// as in Python, and products and curves are computed by numpy's own inner loops: the numbers are the same bit for bit.
// Python keeps all arrays that are handed over alive. No exception leaves a function: they return FAILED, and
// `core_message` says why.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <vector>

#include <libsumo/Simulation.h>
#include <libsumo/TraCIConstants.h>
#include <libsumo/Vehicle.h>

namespace {

using Simulation = libsumo::Simulation;
using Api = libsumo::Vehicle;
using Loop = void (*)(char**, const intptr_t*, const intptr_t*, void*);  // an inner loop of a ufunc of numpy

enum Status { QUIET = 0, JUDGE = 1, DECIDE = 2, REFUSED = 3, FAILED = -1 };

const std::string SHADOW = "twin:";
const double PI = 3.141592653589793;
const double NOWHERE = libsumo::INVALID_DOUBLE_VALUE;
const double SAME_LANE = 1.0, LANE_AHEAD = 80.0, REACH = 150.0, CLEARANCE = 0.5, LARGEST = 1e6;
const double SLACK = 1e-6;  // [m] by which boxes are apart for sure
const double FAR = 500.0;  // [m], cosim.loop.membership.FAR
const double IN_SIGHT = 100.0;  // [m], cosim.loop.nearby_vehicles.REACH
const float OWN_WIDTH = 1.8f, OWN_LENGTH = 5.0f, LOOK_AHEAD = 1.0f;  // gri.networks.next_ahead
const float GAIN = 0.8f, FREE = 0.5f, SLOWEST = 1.0f, LATERAL_ACCELERATION = 3.0f;  // the same
const struct { double valid, along, across, beyond; } RINGS[] = {{5.0, 150.0, 20.0, 300.0}, {1.0, 30.0, 4.0, 60.0}};
const int FEATURES = 7;  // s, d, x, y, heading, v, a
enum { S, D, X, Y, HEADING, V, A };

bool is_shadow(const std::string& id) { return id.compare(0, SHADOW.size(), SHADOW) == 0; }

double floor_mod(double value, double divisor) {  // `%` of Python and numpy, for a positive divisor
    double rest = std::fmod(value, divisor);
    if (rest == 0.0) return std::copysign(0.0, divisor);
    return rest < 0 ? rest + divisor : rest;
}
double heading_of(double angle) {
    const double heading = (90.0 - angle) * (PI / 180.0);
    return -(floor_mod(-heading + PI, 2 * PI) - PI);
}
double sumo_angle_of(double heading) { return floor_mod(90.0 - heading * (180.0 / PI), 360.0); }
double wrapped(double angle) { return floor_mod(angle + PI, 2 * PI) - PI; }

std::vector<std::string> lines_of(const char* text) {
    std::vector<std::string> found;
    for (const char* begin = text; *begin;) {
        const char* end = std::strchr(begin, '\n');
        if (!end) end = begin + std::strlen(begin);
        found.emplace_back(begin, end);
        begin = *end ? end + 1 : end;
    }
    return found;
}

struct Car {
    std::string id;
    double s, d, x, y, heading, v, a, length, width;
    double seen = -std::numeric_limits<double>::infinity();  // [s], when its speed was last read
    int row = -1;  // among the vehicles near, in the last reading
    bool sized = false, present = false, taken = false, close = false;
};
using Cars = std::vector<Car*>;

struct Listed {  // a list that was recorded, and its index in `lists`
    Cars cars;
    int32_t version = -1;
};

struct Ring {
    double time;
    Cars near, in_spans;
};

struct Array {  // a matrix of numpy
    char* data;
    intptr_t rows, columns, row_step, column_step;
};

struct Policy {  // gri.networks.fast_decoder.FewVehicles
    bool given = false;
    intptr_t vehicles, driven, inputs, pairs, end_sender, end_receiver, actions;
    Array read, edge, node, last;
    std::vector<Array> inner;
    const float *read_bias, *edge_bias, *last_bias, *unit, *mask;
    std::vector<const float*> inner_bias;
    const int64_t *senders, *receivers, *driven_rows, *turn_ends;
    intptr_t turns;
    const int64_t* turn_receivers;
    std::vector<float> relative, parts, sent, messages, sums, hidden, next, curve, action;
};

struct Strip { double begin, end, centre, width; };

struct Core {
    // What does not change
    double dt, settle, sx, sy, dx, dy, nx, ny, origin, arc, road_heading;
    bool euler, records, merge, has_third, planar;
    int groups, size, features, every, side;
    bool join;  // whether others may join a group, so that it has other members and some roles are empty
    const double *offset, *across, *member_width;
    Strip source, target;
    std::vector<double> pair_ends;
    std::vector<std::string> pair_source, pair_target;
    Loop matmul_f, matmul_d, tanh_f, cos_d, sin_d, sin_f;
    void *matmul_f_data, *matmul_d_data, *tanh_f_data, *cos_d_data, *sin_d_data, *sin_f_data;
    Array matrix;  // of the dynamics, transposed
    Policy policy, follower;  // under the graph, and in scenes of two: behind the next vehicle ahead
    // Functions of Python, which return 0, or another number if they failed
    int (*shadow_call)(int, int);  // (group, 1 to add and 0 to remove its shadow)
    int (*step_call)();  // before every step; may be none
    // What Python and this code share: model states, commanded ones and actions of all vehicles, who is active
    double *state, *commanded, *pose;
    float* action;
    uint8_t *active, *shadowed, *driven;  // by group, by group, by group and role
    int64_t* inside;  // steps of vehicle 0 in the target lane, at a stretch, by group
    // The traffic
    std::unordered_map<std::string, std::unique_ptr<Car>> all;
    Cars known, found, near;
    Cars at_start, members;  // of the groups: at the take-over, and now (none where nobody has a role)
    std::vector<Ring> rings;
    Cars ahead, watched;
    intptr_t ahead_steps = 0;
    const double* ahead_speeds;
    std::vector<double> before, observed;  // states of the members [G, N, 7], one step ago and now
    std::vector<uint8_t> valid;
    double time;
    long decisions = 0;
    std::vector<double> joined, following, cosine;
    std::vector<float> sideways;  // speeds across the road, in the model's states
    std::vector<intptr_t> scene_of;  // whose the scenes of two are
    // What a call of `advance` recorded
    int steps = 0;
    std::vector<double> times, blocks, sizes, observations, poses, states, speeds;
    std::vector<int32_t> counts, near_counts, versions, near_versions, near_rows, rows;
    std::vector<uint8_t> valids;
    std::vector<std::string> lists;  // ids of vehicles, each list once
    Listed last_found, last_near;
    std::vector<std::string> lanes;  // of the vehicles near, after the last step
    std::string message, text;

    Car* car(const std::string& id) {
        auto& place = all[id];
        if (!place) {
            place.reset(new Car);
            place->id = id;
        }
        return place.get();
    }
    Cars cars(const char* ids) {
        Cars result;
        for (const auto& id : lines_of(ids)) result.push_back(car(id));
        return result;
    }

    // ---- Who is there ----

    void ask_for_known() {
        for (Car* one : known) one->present = false;
        known.clear();
        for (const auto& id : Api::getIDList())
            if (!is_shadow(id)) {
                known.push_back(car(id));
                known.back()->present = true;
            }
    }
    static void enter(Cars& listed, Car* one) {
        auto place = std::lower_bound(listed.begin(), listed.end(), one, [](Car* a, Car* b) { return a->id < b->id; });
        if (place == listed.end() || *place != one) listed.insert(place, one);
    }
    static void leave(Cars& listed, Car* one) {
        listed.erase(std::remove(listed.begin(), listed.end(), one), listed.end());
    }
    bool update_known() {  // true if nobody was teleported
        const auto departed = Simulation::getDepartedIDList(), arrived = Simulation::getArrivedIDList();
        const bool teleported =
            !Simulation::getStartingTeleportIDList().empty() || !Simulation::getEndingTeleportIDList().empty();
        for (const auto& id : departed)
            if (!is_shadow(id)) {
                Car* one = car(id);
                one->present = true;
                enter(known, one);
                for (auto& ring : rings) {
                    ring.near.push_back(one);
                    if (records) enter(ring.in_spans, one);
                }
            }
        for (const auto& id : arrived) {
            Car* one = car(id);
            one->present = false;
            leave(known, one);
            for (auto& ring : rings) {
                leave(ring.near, one);
                leave(ring.in_spans, one);
            }
        }
        if (teleported) {
            rings.clear();
            ask_for_known();
        }
        return !teleported;
    }

    // ---- Reading ----

    Cars placed(const Cars& wanted) {
        Cars result;
        result.reserve(wanted.size());
        for (Car* one : wanted) {
            const auto position = Api::getPosition(one->id);
            if (position.x == NOWHERE) continue;
            one->x = position.x;
            one->y = position.y;
            const double x = one->x - sx, y = one->y - sy;
            one->s = (x * dx + y * dy) - origin;
            one->d = dx * y - dy * x;
            result.push_back(one);
        }
        return result;
    }
    Cars all_placed() {
        try {
            return placed(known);
        } catch (const libsumo::TraCIException&) {  // a vehicle vanished without having arrived
            ask_for_known();
            return placed(known);
        }
    }
    Cars only_near(const Cars& listed, double along, double beside) {
        Cars given, result;
        for (Car* one : listed)
            if (one->close) given.push_back(one);
        for (Car* one : listed)
            for (const Car* other : given) {
                const double ds = std::fabs(one->s - other->s), dd = std::fabs(one->d - other->d);
                if ((ds < LANE_AHEAD + along && dd < 2 + beside) || (ds < 25 + along && dd < 6 + beside)) {
                    result.push_back(one);
                    break;
                }
            }
        return result;
    }
    void index(const Cars& listed) {
        for (auto& entry : all) entry.second->row = -1;
        for (size_t row = 0; row < listed.size(); ++row) listed[row]->row = static_cast<int>(row);
    }
    void find() {
        const size_t most = 2;
        while (!rings.empty() && !(rings.back().time >= time - RINGS[rings.size() - 1].valid + 1e-6)) rings.pop_back();
        try {
            found = rings.empty() ? all_placed() : placed(records ? rings.back().in_spans : rings.back().near);
        } catch (const libsumo::TraCIException&) {
            rings.clear();
            found = all_placed();
        }
        if (rings.size() < most) {
            Cars close = found;
            if (records && !rings.empty()) {
                index(found);
                close.clear();
                for (Car* one : rings.back().near)
                    if (one->row >= 0) close.push_back(one);
            }
            for (size_t k = rings.size(); k < most; ++k) {
                close = only_near(close, RINGS[k].along, RINGS[k].across);
                if (records) {
                    Cars inside;
                    for (Car* one : found)
                        if (in_a_span(one->s, RINGS[k].beyond)) inside.push_back(one);
                    found = inside;
                }
                rings.push_back({time, close, found});
            }
            if (!records) found = close;
        }
        if (!records) {
            near = found;
            return;
        }
        near.clear();
        for (Car* one : rings.back().near)
            if (std::binary_search(found.begin(), found.end(), one, [](Car* a, Car* b) { return a->id < b->id; }))
                near.push_back(one);
    }
    bool in_a_span(double s, double beyond) {
        for (int g = 0; g < groups; ++g) {
            const double* of = &observed[g * size * FEATURES];  // one step ago
            double low = of[S], high = of[S];
            for (int role = 1; role < size; ++role) {
                low = std::min(low, of[role * FEATURES + S]);
                high = std::max(high, of[role * FEATURES + S]);
            }
            if (s >= (low - REACH) + -beyond && s <= (high + REACH) + beyond) return true;
        }
        return false;
    }
    void read() {
        find();
        const double earlier = time - dt;
        for (Car* one : found) {
            one->heading = heading_of(Api::getAngle(one->id));
            const double v = Api::getSpeed(one->id);
            if (!euler || one->taken || !(std::fabs(one->seen - earlier) <= 1e-6))
                one->a = Api::getAcceleration(one->id);
            else
                one->a = (v - one->v) / dt;
            one->v = v;
            one->seen = time;
            if (!one->sized) {
                one->length = Api::getLength(one->id);
                one->width = Api::getWidth(one->id);
                one->sized = true;
            }
        }
    }

    // ---- Recording ----

    int version_of(const Cars& listed, Listed& last) {
        if (last.version < 0 || listed != last.cars) {
            std::string text;
            for (const Car* one : listed) {
                if (!text.empty()) text += '\n';
                text += one->id;
            }
            lists.push_back(text);
            last = {listed, static_cast<int32_t>(lists.size()) - 1};
        }
        return last.version;
    }
    void record(bool driving) {
        const size_t n = found.size(), begin = blocks.size();
        blocks.resize(begin + FEATURES * n);
        sizes.resize(sizes.size() + 2 * n);
        double *block = &blocks[begin], *size_block = &sizes[sizes.size() - 2 * n];
        for (size_t k = 0; k < n; ++k) {
            Car* one = found[k];
            one->row = static_cast<int>(k);
            const double values[FEATURES] = {one->s, one->d, one->x, one->y, one->heading, one->v, one->a};
            for (int feature = 0; feature < FEATURES; ++feature) block[feature * n + k] = values[feature];
            size_block[k] = one->length;
            size_block[n + k] = one->width;
        }
        for (const Car* one : near) near_rows.push_back(one->row);
        versions.push_back(version_of(found, last_found));
        near_versions.push_back(version_of(near, last_near));
        counts.push_back(static_cast<int32_t>(n));
        near_counts.push_back(static_cast<int32_t>(near.size()));
        times.push_back(time);
        for (Car* one : at_start) one->row = -1;
        for (Car* one : members)
            if (one) one->row = -1;
        for (size_t k = 0; k < near.size(); ++k) near[k]->row = static_cast<int>(k);
        const int count = groups * size;
        before = observed;  // with the last known states of absent vehicles
        observed.assign(count * FEATURES, 0.0);
        for (int k = 0; k < count; ++k) {
            const Car* one = members[k];
            valid[k] = one && one->row >= 0;
            rows.push_back(valid[k] ? one->row : 0);
            if (!valid[k]) continue;
            double* of = &observed[k * FEATURES];
            const double values[FEATURES] = {one->s, one->d, one->x, one->y, one->heading, one->v, one->a};
            std::copy(values, values + FEATURES, of);
            if (driving && is_driven(k)) of[A] = pose[4 * count + k];
        }
        observations.insert(observations.end(), observed.begin(), observed.end());
        valids.insert(valids.end(), valid.begin(), valid.end());
        if (driving) poses.insert(poses.end(), pose, pose + 5 * count);
        for (int k = 0; k < count; ++k)
            if (!valid[k]) std::copy_n(&before[k * FEATURES], FEATURES, &observed[k * FEATURES]);
        ++steps;
    }
    void record_lanes() {  // of the vehicles near, after the last step
        for (const Car* one : near) lanes.push_back(Api::getLaneID(one->id));
    }
    bool is_driven(int k) const { return active[k / size] && driven[k]; }

    // ---- Whether anything happened ----

    bool apart() const {  // whether all boxes of members are apart from all others, beyond doubt
        const size_t n = near.size();
        std::vector<double> c(n), s(n), x(n), y(n), hx(n), hy(n);
        for (size_t k = 0; k < n; ++k) {
            const Car& one = *near[k];
            c[k] = std::cos(one.heading);
            s[k] = std::sin(one.heading);
            x[k] = one.x - 0.5 * one.length * c[k];
            y[k] = one.y - 0.5 * one.length * s[k];
            hx[k] = 0.5 * (one.length * std::fabs(c[k]) + one.width * std::fabs(s[k]));
            hy[k] = 0.5 * (one.length * std::fabs(s[k]) + one.width * std::fabs(c[k]));
        }
        for (const Car* member : at_start) {
            if (member->row < 0) continue;
            const size_t i = member->row;
            for (size_t j = 0; j < n; ++j) {
                if (j == i || std::fabs(x[i] - x[j]) >= hx[i] + hx[j] + SLACK ||
                    std::fabs(y[i] - y[j]) >= hy[i] + hy[j] + SLACK)
                    continue;
                const double rx = x[j] - x[i], ry = y[j] - y[i];
                const double cosine = std::fabs(c[i] * c[j] + s[i] * s[j]), sine = std::fabs(c[i] * s[j] - s[i] * c[j]);
                bool separate = false;
                for (int turn = 0; turn < 2; ++turn) {
                    const size_t own = turn ? j : i, other = turn ? i : j;
                    const Car &one = *near[own], &two = *near[other];
                    const double along = std::fabs(c[own] * rx + s[own] * ry);
                    const double beside = std::fabs(c[own] * ry - s[own] * rx);
                    separate |= along >= 0.5 * (one.length + two.length * cosine + two.width * sine) + SLACK;
                    separate |= beside >= 0.5 * (one.width + two.length * sine + two.width * cosine) + SLACK;
                }
                if (!separate) return false;
            }
        }
        return true;
    }
    bool on_lanes() const {  // whether all driven vehicles are
        for (int k = 0; k < groups * size; ++k)
            if (is_driven(k) && valid[k] && Api::getLaneID(members[k]->id).empty()) return false;
        return true;
    }
    bool complete() const {  // whether everybody who has a role in an active group is there
        for (int k = 0; k < groups * size; ++k)
            if (active[k / size] && members[k] && !valid[k]) return false;
        return true;
    }
    bool nobody_joins() const {  // whether cosim.loop.membership changes no role of an active group
        for (int g = 0; g < groups; ++g)
            if (active[g] && !(merge ? beside_as_before(&members[g * size]) : ahead_as_before(&members[g * size])))
                return false;
        return true;
    }
    bool beside_as_before(Car* const* of) const {  // lag vehicle and leader of a merge
        const Car *own = of[0], *lag = of[1], *leader = of[2];
        const double front = own->s, rear = own->s - own->length;
        const auto in_lane = [&](const Car* one) { return std::fabs(one->d - target.centre) < SAME_LANE; };
        if (leader && (!in_lane(leader) || leader->s < rear)) return false;
        if (lag && (!in_lane(lag) || lag->s - lag->length > front)) return false;
        for (const Car* one : near) {
            if (one == own || one == lag || one == leader || !in_lane(one)) continue;
            if (leader && !(one->s < leader->s)) continue;
            if (one->s > front || !lag || one->s > lag->s) return false;
        }
        return true;
    }
    bool ahead_as_before(Car* const* of) const {  // the vehicles ahead of vehicle 0, one after the other
        for (int role = 0; role + 1 < size && of[role]; ++role) {
            const Car *behind = of[role], *leader = of[role + 1];
            const double own = leader ? leader->s - behind->s : std::numeric_limits<double>::infinity();
            if (leader && !(own > 0 && std::fabs(leader->d - behind->d) < SAME_LANE)) return false;
            for (const Car* one : near) {
                const double distance = one->s - behind->s;
                if (one != leader && distance > 0 && distance <= own && std::fabs(one->d - behind->d) < SAME_LANE)
                    return false;
            }
        }
        return true;
    }
    bool all_follow() const {  // cosim.loop.end_conditions.all_follow
        const int followers = has_third ? size - 1 : 1;
        size_t between = 0, wanted = 0;
        for (int g = 0; g < groups; ++g) {
            if (!active[g]) continue;
            for (int role = 0; role < size; ++role) {
                const int k = (g * size + role) * FEATURES + D;
                if (std::fabs(observed[k] - before[k]) > SAME_LANE) return false;
            }
            for (int role = 0; role < followers; ++role, ++wanted) {
                const Car *behind = members[g * size + role], *leader = members[g * size + role + 1];
                const double own = leader->s - behind->s;
                bool is_next = false;
                for (const Car* one : near) {
                    const double distance = one->s - behind->s;
                    if (distance > 0 && distance <= own && std::fabs(one->d - behind->d) < SAME_LANE) {
                        ++between;
                        is_next |= one == leader;
                    }
                }
                if (!is_next) return false;
            }
        }
        return between == wanted;
    }
    bool none_merged() {  // whether cosim.loop.end_conditions.merging ends no active group; counts `inside` if so
        std::vector<int64_t> now_inside(inside, inside + groups);
        for (int g = 0; g < groups; ++g) {
            if (!active[g]) continue;
            const double* now = &observed[g * 3 * FEATURES];
            if (join) {
                if (ends_or_settles(g, now, now_inside[g])) return false;
                continue;
            }
            const double* was = &before[g * 3 * FEATURES];
            for (int role = 1; role < 3; ++role)
                if (std::fabs(now[role * FEATURES + D] - was[role * FEATURES + D]) > SAME_LANE) return false;
            Car* const* of = &members[g * 3];
            const Car *lag = of[1], *leader = has_third ? of[2] : of[1];
            for (const Car* one : near)
                if (std::fabs(one->d - target.centre) < SAME_LANE && one->s > lag->s && one->s < leader->s &&
                    one != of[0] && one != lag && one != leader)
                    return false;
            if (ends_or_settles(g, now, now_inside[g])) return false;
            if (now_inside[g] && std::fabs(now[FEATURES + D] - target.centre) > 0.5 * target.width) return false;
        }
        std::copy(now_inside.begin(), now_inside.end(), inside);
        return true;
    }
    bool ends_or_settles(int g, const double* now, int64_t& steps_inside) const {  // end_conditions.merging_alone
        const double beyond = side * (now[D] - (target.centre - side * 0.5 * target.width));
        if (now[S] + now[V] * dt >= source.end && beyond < 0) return true;
        if (std::fabs(now[D] - target.centre) + 0.5 * member_width[g * 3] <= 0.5 * target.width)
            return ++steps_inside * dt >= settle - 1e-6;
        steps_inside = 0;
        return false;
    }
    bool goes_on() const {  // whether the rule ends no group, apart from merges
        return join ? nobody_joins() : merge || all_follow();
    }

    // ---- Deciding ----

    static void call(Loop loop, void* data, const char* in, char* out, intptr_t n, intptr_t step) {
        char* arguments[2] = {const_cast<char*>(in), out};
        const intptr_t steps[2] = {step, step};
        loop(arguments, &n, steps, data);
    }
    template <class T>
    static void product(Loop loop, void* data, const T* x, intptr_t m, const Array& weight, T* out) {
        const intptr_t n = weight.rows, p = weight.columns, w = sizeof(T);
        char* arguments[3] = {const_cast<char*>(reinterpret_cast<const char*>(x)), weight.data,
                              reinterpret_cast<char*>(out)};
        const intptr_t dimensions[4] = {1, m, n, p};
        const intptr_t steps[9] = {m * n * w, n * p * w, m * p * w, n * w, w, weight.row_step, weight.column_step,
                                   p * w, w};
        loop(arguments, dimensions, steps, data);
    }
    void layer(const float* x, intptr_t m, const Array& weight, const float* bias, std::vector<float>& out) {
        product(matmul_f, matmul_f_data, x, m, weight, out.data());
        const intptr_t p = weight.columns;
        for (intptr_t row = 0; bias && row < m; ++row)
            for (intptr_t k = 0; k < p; ++k) out[row * p + k] += bias[k];
    }
    void silu_of_half(Policy& p, std::vector<float>& half, intptr_t n) {
        std::vector<float>& curve = p.curve;
        call(tanh_f, tanh_f_data, reinterpret_cast<char*>(half.data()), reinterpret_cast<char*>(curve.data()), n,
             sizeof(float));
        for (intptr_t k = 0; k < n; ++k) curve[k] *= half[k];
        for (intptr_t k = 0; k < n; ++k) half[k] += curve[k];
    }
    // gri.networks.fast_decoder.FewVehicles for states in `relative`: so many rows, pairs and driven vehicles of it
    void run(Policy& p, intptr_t rows, intptr_t pairs, intptr_t driven_rows) {
        const intptr_t parts = p.read.columns, hidden = p.node.columns, width = p.edge.columns;
        layer(p.relative.data(), rows, p.read, p.read_bias, p.parts);
        for (intptr_t pair = 0; pair < pairs; ++pair) {
            const float *sender = &p.parts[p.senders[pair] * parts], *receiver = &p.parts[p.receivers[pair] * parts];
            for (intptr_t k = 0; k < p.end_sender; ++k)
                p.sent[pair * p.end_sender + k] = sender[k] + receiver[p.end_sender + k];
        }
        if (pairs) {
            silu_of_half(p, p.sent, pairs * p.end_sender);
            if (p.mask)
                for (intptr_t k = 0; k < pairs * p.end_sender; ++k) p.sent[k] *= p.mask[k];
            layer(p.sent.data(), pairs, p.edge, nullptr, p.messages);
            for (intptr_t k = 0; k < pairs * width; ++k) p.messages[k] += p.edge_bias[k];
            silu_of_half(p, p.messages, pairs * width);
        }
        for (intptr_t turn = 0; turn < p.turns; ++turn)
            for (intptr_t pair = turn ? p.turn_ends[turn - 1] : 0; pair < std::min(p.turn_ends[turn], pairs); ++pair) {
                float* sum = &p.sums[p.turn_receivers[pair] * width];
                const float* message = &p.messages[pair * width];
                for (intptr_t k = 0; k < width; ++k) sum[k] = turn ? sum[k] + message[k] : message[k];
            }
        layer(p.sums.data(), driven_rows, p.node, nullptr, p.hidden);
        for (intptr_t row = 0; row < driven_rows; ++row) {
            const float* own = &p.parts[p.driven_rows[row] * parts + p.end_receiver];
            for (intptr_t k = 0; k < hidden; ++k) p.hidden[row * hidden + k] += own[k];
        }
        silu_of_half(p, p.hidden, driven_rows * hidden);
        for (size_t k = 0; k < p.inner.size(); ++k) {
            layer(p.hidden.data(), driven_rows, p.inner[k], p.inner_bias[k], p.next);
            silu_of_half(p, p.next, driven_rows * p.inner[k].columns);
            p.hidden.swap(p.next);
        }
        layer(p.hidden.data(), driven_rows, p.last, p.last_bias, p.action);
        for (intptr_t row = 0; row < driven_rows; ++row)
            for (intptr_t k = 0; k < p.actions; ++k) p.action[row * p.actions + k] *= p.unit[k];
    }
    bool act() {  // cosim.loop.policy_runner; false for unusable actions
        Policy& p = policy;
        for (int g = 0; g < groups; ++g) {
            const double leader = state[(g * size + size - 1) * features];
            for (int role = 0; role < size; ++role)
                for (int f = 0; f < features; ++f) {
                    const intptr_t at = (g * size + role) * features + f;
                    p.relative[at] = static_cast<float>(f ? state[at] : state[at] - leader);
                }
        }
        run(p, groups * size, p.pairs, p.driven);
        if (follower.given) follow_next_ahead();
        for (intptr_t k = 0; k < p.driven * p.actions; ++k)
            if (!(std::fabs(p.action[k]) <= LARGEST)) return false;
        return true;
    }
    void follow_next_ahead() {  // gri.networks.next_ahead.FollowsNextAhead
        const intptr_t count = groups * size, width = features * sizeof(float);
        const float* of = policy.relative.data();
        if (planar) {
            char* arguments[2] = {const_cast<char*>(reinterpret_cast<const char*>(of + 3)),
                                  reinterpret_cast<char*>(sideways.data())};
            const intptr_t steps[2] = {width, sizeof(float)};
            sin_f(arguments, &count, steps, sin_f_data);
            for (intptr_t k = 0; k < count; ++k) sideways[k] = of[k * features + 2] * sideways[k];
        }
        scene_of.clear();
        for (int g = 0; g < groups; ++g) {
            double low = std::numeric_limits<double>::infinity(), high = -low;
            for (int role = 0; role < size; ++role) {
                const double s = state[(g * size + role) * features] - offset[g * size + role];
                low = std::min(low, s), high = std::max(high, s);
            }
            for (int role = 0; role < size; ++role) add_scene(g, role, low - IN_SIGHT, high + IN_SIGHT);
        }
        const intptr_t scenes = static_cast<intptr_t>(scene_of.size());
        if (planar) stay_in_lane();
        if (!scenes) return;
        run(follower, 2 * scenes, follower.pairs / count * scenes, 2 * scenes);
        for (intptr_t k = 0; k < scenes; ++k) {
            float& own = policy.action[scene_of[k] * policy.actions];
            const float behind = follower.action[2 * k * follower.actions];
            if (behind < own || std::isnan(behind)) own = behind;
        }
    }
    void stay_in_lane() {  // FollowsNextAhead._greatest_turn
        const float step = static_cast<float>(every * dt);  // between two actions
        for (intptr_t k = 0; k < groups * size; ++k) {
            const float* own = &policy.relative[k * features];
            const float v = own[2] > SLOWEST ? own[2] : SLOWEST;
            const float greatest = (FREE - GAIN * own[1]) / v;
            const float turn = (greatest - (own[3] + own[5] * step)) / step, hardest = -LATERAL_ACCELERATION / v;
            const float limit = ((turn > hardest ? turn : hardest) - own[5]) / step;
            float& yaw = policy.action[k * policy.actions + 1];
            if (limit < yaw) yaw = limit;
        }
    }
    void add_scene(int g, int role, double low, double high) {  // of a vehicle and the next one ahead, if there is one
        const intptr_t k = g * size + role;
        const float *own = &policy.relative[k * features], *other = nullptr;
        const float y = planar ? own[1] : 0.0f, none = std::numeric_limits<float>::infinity();
        float gap = none;
        for (int j = 0; j < size; ++j) {
            const float* one = &policy.relative[(g * size + j) * features];
            const float ahead = one[0] - own[0], across = planar ? one[1] - y : 0.0f;
            float beside = std::fabs(across);
            if (planar) {
                const float sign = across > 0 ? 1.0f : across < 0 ? -1.0f : 0.0f;
                const float closer = -sign * (sideways[g * size + j] - sideways[k]);
                beside -= (closer > 0 ? closer : 0.0f) * LOOK_AHEAD;
            }
            if (beside < OWN_WIDTH && ahead > 0 && ahead - OWN_LENGTH < gap) gap = ahead - OWN_LENGTH, other = one;
        }
        const double s = state[k * features] - offset[k];
        const double d = planar ? side * state[k * features + 1] + across[g] : across[k];
        float outside = none, outside_v = 0.0f;
        for (const Car* one : near) {
            if (!(one->s >= low && one->s <= high) || is_member(g, one)) continue;
            const float ahead = static_cast<float>(one->s - s), length = static_cast<float>(one->length);
            const float beside = std::fabs(static_cast<float>(side * (one->d - d)));
            if (beside < 0.5f * (static_cast<float>(one->width) + OWN_WIDTH) && ahead > 0 && ahead - length < outside)
                outside = ahead - length, outside_v = static_cast<float>(one->v);
        }
        if (!(gap < none) && !(outside < none)) return;
        const intptr_t to = 2 * scene_of.size() * features;
        float *behind = &follower.relative[to], *leader = behind + features;
        std::copy_n(own, features, behind);
        if (outside < gap) {
            std::fill_n(leader, features, 0.0f);
            leader[0] = own[0] + outside + OWN_LENGTH;
            if (planar) leader[1] = y;
            leader[planar ? 2 : 1] = outside_v;
        } else {
            std::copy_n(other, features, leader);
        }
        behind[0] -= leader[0];
        leader[0] -= leader[0];
        scene_of.push_back(k);
    }
    bool is_member(int g, const Car* one) const {
        return std::find(&members[g * size], &members[g * size] + size, one) != &members[g * size] + size;
    }
    bool decide() {
        if (!policy.given) return false;
        const bool new_action = decisions % every == 0;
        if (new_action && !act()) return false;
        const int count = groups * size, actions = features == 3 ? 1 : 2, inputs = static_cast<int>(matrix.rows);
        const float* of = new_action ? policy.action.data() : action;
        for (int k = 0; k < count; ++k) {
            double* row = &joined[k * inputs];
            std::copy_n(&state[k * features], features, row);
            for (int f = 0; f < actions; ++f) row[features + f] = of[k * actions + f];
        }
        if (planar) {
            const char* heading = reinterpret_cast<const char*>(state + 3);
            std::vector<double>& value = cosine;
            for (int axis = 0; axis < 2; ++axis) {
                char* arguments[2] = {const_cast<char*>(heading), reinterpret_cast<char*>(value.data())};
                const intptr_t n = count, steps[2] = {static_cast<intptr_t>(features * sizeof(double)), sizeof(double)};
                axis ? sin_d(arguments, &n, steps, sin_d_data) : cos_d(arguments, &n, steps, cos_d_data);
                for (int k = 0; k < count; ++k)
                    joined[k * inputs + features + actions + axis] = state[k * features + 2] * value[k];
            }
        }
        product(matmul_d, matmul_d_data, joined.data(), count, matrix, following.data());
        const int speed = planar ? 2 : 1;
        for (int k = 0; k < count; ++k)
            if (following[k * features + speed] < 0) return false;  // Python stops it
        states.insert(states.end(), state, state + count * features);
        if (new_action) std::copy_n(policy.action.data(), count * actions, action);
        std::copy_n(following.data(), count * features, commanded);
        ++decisions;
        for (int k = 0; k < count; ++k) {
            const double* next = &commanded[k * features];
            pose[k] = next[0] - offset[k];
            pose[count + k] = planar ? side * next[1] + across[k / size] : across[k];
            pose[2 * count + k] = planar ? side * next[3] : 0.0;
            pose[3 * count + k] = next[speed];
            pose[4 * count + k] = planar ? next[4] : next[2];
        }
        return true;
    }
    void observe() {  // the states from which the policy decides next
        const int count = groups * size;
        const double* latest = &observations[observations.size() - count * FEATURES];  // absent vehicles are 0
        for (int k = 0; k < count; ++k) {
            double* of = &state[k * features];
            if (is_driven(k)) {
                std::copy_n(&commanded[k * features], features, of);
                continue;
            }
            const double* now = &latest[k * FEATURES];
            double far_away[FEATURES];
            if (!members[k]) {  // cosim.loop.membership.Membership.shown
                const double* own = &latest[k / size * size * FEATURES];
                far_away[S] = own[S] + (merge && k % size == 1 ? -FAR : FAR);
                far_away[D] = merge ? target.centre : own[D];
                far_away[HEADING] = road_heading, far_away[V] = own[V], far_away[A] = 0.0;
                now = far_away;
            }
            of[0] = now[S] + offset[k];
            if (planar) {
                const double turn = wrapped(now[HEADING] - road_heading);
                of[1] = side * (now[D] - across[k / size]);
                of[2] = now[V];
                of[3] = side * turn;
                of[4] = now[A];
                of[5] = 0.0;
            } else {
                of[1] = now[V];
                of[2] = now[A];
            }
        }
    }

    // ---- Commanding ----

    void world(double s, double d, double& x, double& y) const {
        const double along = s + origin - arc;
        x = (sx + along * dx) + d * nx;
        y = (sy + along * dy) + d * ny;
    }
    static void move(const std::string& id, double x, double y, double heading, double v, const std::string& lane) {
        Api::setSpeed(id, v);
        const size_t cut = lane.rfind('_');
        Api::moveToXY(id, lane.substr(0, cut), std::stoi(lane.substr(cut + 1)), x, y, sumo_angle_of(heading), 2);
    }
    bool is_free(double s, const Car* own) const {
        for (const Car* one : near) {
            if (one == own || !(std::fabs(one->d - target.centre) < 0.5 * target.width)) continue;
            const double front = one->s + one->v * dt;
            if (!(front < s - own->length - CLEARANCE || front - one->length > s + CLEARANCE)) return false;
        }
        return true;
    }
    const std::string& lane_at(double s, const std::vector<std::string>& names) const {
        size_t k = 0;
        while (k + 1 < pair_ends.size() && !(s < pair_ends[k])) ++k;
        return names[k];
    }
    void shadow(int g, bool wanted) {
        if (static_cast<bool>(shadowed[g]) == wanted) return;
        if (shadow_call(g, wanted)) throw std::runtime_error("a shadow vehicle could not be changed");
        shadowed[g] = wanted;
    }
    std::string place_shadow(int g) {  // cosim.loop.shadow_vehicles.place; the lane of the vehicle itself
        const int count = groups * size, k = g * size;
        const Car* own = members[k];
        if (own->row < 0) {
            shadow(g, false);
            return "";
        }
        const double s = pose[k], d = pose[count + k], heading = pose[2 * count + k], v = pose[3 * count + k];
        std::string lane, shadow_lane;
        double shadow_d = d;
        bool announces = false;
        if (s >= std::max(source.begin, target.begin) && s <= std::min(source.end, target.end)) {
            const double beyond = side * (d - (target.centre - side * 0.5 * target.width)), half = 0.5 * own->width;
            const std::string &from = lane_at(s, pair_source), &to = lane_at(s, pair_target);
            if (beyond >= half) {
            } else if (beyond >= 0) {
                lane = to;
                shadow_lane = from;
            } else if (beyond > -half) {
                lane = from;
                shadow_lane = to;
            } else {
                shadow_lane = to;
                shadow_d = target.centre;
                announces = true;
            }
        }
        if (shadow_lane.empty() || (announces && !is_free(s, own))) {
            shadow(g, false);
            return lane;
        }
        double x, y;
        world(s, shadow_d, x, y);
        shadow(g, true);
        move(SHADOW + own->id, x, y, road_heading + (announces ? 0.0 : heading), v, shadow_lane);
        return lane;
    }
    bool command() {
        const int count = groups * size;
        for (int k = 0; k < count; ++k)
            if (is_driven(k) && !std::isfinite(pose[k] + pose[count + k] + pose[2 * count + k] + pose[3 * count + k]))
                return false;
        std::vector<std::string> lanes_of(groups);
        bool any = false;
        if (merge)
            for (int g = 0; g < groups; ++g)
                if (is_driven(g * size)) any |= !(lanes_of[g] = place_shadow(g)).empty();
        if (!any)
            for (int k = 0; k < count; ++k)
                if (is_driven(k)) Api::setSpeed(members[k]->id, pose[3 * count + k]);
        for (int k = 0; k < count; ++k) {
            if (!is_driven(k)) continue;
            double x, y;
            world(pose[k], pose[count + k], x, y);
            const double heading = road_heading + pose[2 * count + k];
            const std::string& lane = lanes_of[k / size];
            if (k % size == 0 && !lane.empty()) {
                move(members[k]->id, x, y, heading, pose[3 * count + k], lane);
                continue;
            }
            if (any) Api::setSpeed(members[k]->id, pose[3 * count + k]);
            Api::moveToXY(members[k]->id, "", -1, x, y, sumo_angle_of(heading), 3);
        }
        return true;
    }
    void repeat_speeds(intptr_t step) {
        if (step > ahead_steps) return;
        for (size_t k = 0; k < ahead.size(); ++k)
            if (ahead[k]->present && !ahead[k]->taken)
                Api::setSpeed(ahead[k]->id, step < ahead_steps ? ahead_speeds[step * ahead.size() + k] : -1.0);
    }

    // ---- The loop ----

    int advance(intptr_t step, int most, bool decided, bool driving, bool judging) {
        steps = 0;
        for (auto* of : {&times, &blocks, &sizes, &observations, &poses, &states, &speeds}) of->clear();
        for (auto* of : {&counts, &near_counts, &versions, &near_versions, &near_rows, &rows}) of->clear();
        valids.clear();
        lanes.clear();
        for (int k = 0; k < most; ++k, ++step) {
            if (driving) {
                if (!decided && !decide()) return DECIDE;
                decided = false;
                if (!command()) return REFUSED;
            }
            repeat_speeds(step);
            if (step_call && step_call()) throw std::runtime_error("what is to be done before a step failed");
            Simulation::step();
            time = Simulation::getTime();
            const bool nothing_reported = update_known() & Simulation::getCollisions().empty();
            read();
            record(driving);
            for (const Car* one : watched)
                speeds.push_back(one->present ? Api::getSpeed(one->id) : std::numeric_limits<double>::quiet_NaN());
            bool quiet = nothing_reported && apart();
            if (judging) quiet = quiet && complete() && on_lanes() && goes_on() && (!merge || none_merged());
            if (judging && (!quiet || k == most - 1)) record_lanes();
            if (!quiet) return JUDGE;
            if (driving) observe();
        }
        return QUIET;
    }
};

template <class F>
int guarded(Core* core, F work) {
    try {
        return work();
    } catch (const std::exception& error) {
        core->message = error.what();
    } catch (...) {
        core->message = "unknown error";
    }
    return FAILED;
}

}  // namespace

extern "C" {

// Everything about a round that does not change; the fields are those of `cosim.core.library.RoundFields`.
struct RoundFields {
    double dt, settle, road[10];  // start x, y; direction x, y; normal x, y; origin; arc length; heading; 1 for Euler's update
    int64_t groups, size, features, every, side, records, merge, has_third, join;
    const double *offset, *across, *width, *strips;  // strips: begin, end, centre, width of source and target
    int64_t pairs;
    const double* pair_ends;
    void* loops[12];  // matmul (float), matmul (double), tanh (float), cos, sin, sin (float): each with its data
    Array matrix;
    double *state, *commanded, *pose, *before;
    float* action;
    uint8_t *active, *shadowed, *driven;
    int64_t* inside;
    int (*shadow_call)(int, int);
    int (*step_call)();
};

struct PolicyFields {
    int64_t driven, pairs, end_sender, end_receiver, actions, turns, inner;
    Array read, edge, node, last;
    const Array* inner_weights;
    const float *read_bias, *edge_bias, *last_bias, *unit, *mask;
    const float* const* inner_biases;
    const int64_t *senders, *receivers, *driven_rows, *turn_ends, *turn_receivers;
};

void* core_new(const RoundFields* of, const char* members, const char* pair_sources, const char* pair_targets) {
    Core* core = new Core;
    guarded(core, [&] {
        Core& c = *core;
        c.dt = of->dt, c.settle = of->settle, c.inside = of->inside;
        c.sx = of->road[0], c.sy = of->road[1], c.dx = of->road[2], c.dy = of->road[3], c.nx = of->road[4];
        c.ny = of->road[5], c.origin = of->road[6], c.arc = of->road[7], c.road_heading = of->road[8];
        c.euler = of->road[9] == 1;
        c.groups = static_cast<int>(of->groups), c.size = static_cast<int>(of->size);
        c.features = static_cast<int>(of->features), c.every = static_cast<int>(of->every);
        c.side = static_cast<int>(of->side), c.records = of->records, c.merge = of->merge, c.has_third = of->has_third;
        c.planar = c.features == 6, c.join = of->join;
        c.offset = of->offset, c.across = of->across, c.member_width = of->width;
        if (c.merge) {
            c.source = {of->strips[0], of->strips[1], of->strips[2], of->strips[3]};
            c.target = {of->strips[4], of->strips[5], of->strips[6], of->strips[7]};
            c.pair_ends.assign(of->pair_ends, of->pair_ends + of->pairs);
            c.pair_source = lines_of(pair_sources);
            c.pair_target = lines_of(pair_targets);
        }
        void* const* loop = of->loops;
        c.matmul_f = reinterpret_cast<Loop>(loop[0]), c.matmul_f_data = loop[1];
        c.matmul_d = reinterpret_cast<Loop>(loop[2]), c.matmul_d_data = loop[3];
        c.tanh_f = reinterpret_cast<Loop>(loop[4]), c.tanh_f_data = loop[5];
        c.cos_d = reinterpret_cast<Loop>(loop[6]), c.cos_d_data = loop[7];
        c.sin_d = reinterpret_cast<Loop>(loop[8]), c.sin_d_data = loop[9];
        c.sin_f = reinterpret_cast<Loop>(loop[10]), c.sin_f_data = loop[11];
        c.matrix = of->matrix;
        c.state = of->state, c.commanded = of->commanded, c.pose = of->pose, c.action = of->action;
        c.active = of->active, c.shadowed = of->shadowed, c.driven = of->driven, c.shadow_call = of->shadow_call, c.step_call = of->step_call;
        c.at_start = c.members = c.cars(members);
        for (Car* one : c.members) one->close = true;
        const int count = c.groups * c.size;
        c.observed.assign(of->before, of->before + count * FEATURES);
        c.valid.assign(count, 1);
        c.joined.resize(count * 10);
        c.following.resize(count * 6);
        c.cosine.resize(count);
        c.sideways.resize(count);
        return 0;
    });
    return core;
}

void core_delete(void* core) { delete static_cast<Core*>(core); }

const char* core_message(void* core) { return static_cast<Core*>(core)->message.c_str(); }

// The vehicles at the take-over: rows are s, d, v, length, width. They are near in the first step. `known` are all.
int core_start(void* handle, double time, const char* ids, const double* values, const char* known) {
    Core* core = static_cast<Core*>(handle);
    return guarded(core, [&] {
        core->near = core->cars(ids);
        const size_t n = core->near.size();
        for (Car* one : core->members) one->row = -1;
        for (size_t k = 0; k < n; ++k) {
            Car& one = *core->near[k];
            one.s = values[k], one.d = values[n + k], one.v = values[2 * n + k];
            one.length = values[3 * n + k], one.width = values[4 * n + k];
            one.sized = true, one.seen = time, one.row = static_cast<int>(k);
        }
        core->known = core->cars(known);
        for (Car* one : core->known) one->present = true;
        return 0;
    });
}

// The members of the groups from now on, "" where nobody has a role, and their last known states.
int core_members(void* handle, const char* ids, const double* observed) {
    Core* core = static_cast<Core*>(handle);
    return guarded(core, [&] {
        auto names = lines_of(ids);
        names.resize(core->members.size());
        for (size_t k = 0; k < names.size(); ++k) core->members[k] = names[k].empty() ? nullptr : core->car(names[k]);
        core->observed.assign(observed, observed + names.size() * FEATURES);
        return 0;
    });
}

// The policy under the graph (0), or that in scenes of two (1), of which it has as many as there are members.
int core_policy(void* handle, const PolicyFields* of, int in_pairs) {
    Core* core = static_cast<Core*>(handle);
    return guarded(core, [&] {
        Policy& p = in_pairs ? core->follower : core->policy;
        p.driven = of->driven, p.pairs = of->pairs, p.end_sender = of->end_sender, p.end_receiver = of->end_receiver;
        p.actions = of->actions, p.turns = of->turns;
        p.read = of->read, p.edge = of->edge, p.node = of->node, p.last = of->last;
        p.inner.assign(of->inner_weights, of->inner_weights + of->inner);
        p.inner_bias.assign(of->inner_biases, of->inner_biases + of->inner);
        p.read_bias = of->read_bias, p.edge_bias = of->edge_bias, p.last_bias = of->last_bias;
        p.unit = of->unit, p.mask = of->mask;
        p.senders = of->senders, p.receivers = of->receivers, p.driven_rows = of->driven_rows;
        p.turn_ends = of->turn_ends, p.turn_receivers = of->turn_receivers;
        const size_t rows = core->groups * core->size * (in_pairs ? 2 : 1);
        intptr_t widest = std::max(p.node.columns, p.last.columns);
        for (const Array& weight : p.inner) widest = std::max(widest, weight.columns);
        p.relative.resize(rows * core->features);
        p.parts.resize(rows * p.read.columns);
        p.sent.resize(p.pairs * p.end_sender);
        p.messages.resize(p.pairs * p.edge.columns);
        p.sums.assign(p.driven * p.edge.columns, 0.0f);  // receivers without a sender keep the 0
        p.hidden.resize(p.driven * widest);
        p.next.resize(p.driven * widest);
        p.curve.resize(std::max({p.sent.size(), p.messages.size(), p.hidden.size()}));
        p.action.resize(p.driven * p.actions);
        p.given = true;
        return 0;
    });
}

// The vehicles ahead, and the speeds that their drivers are asked for in each step: -1 for one that decides by itself.
int core_ahead(void* handle, const char* ids, int64_t steps, const double* speeds) {
    Core* core = static_cast<Core*>(handle);
    return guarded(core, [&] {
        core->ahead = core->cars(ids);
        core->ahead_steps = steps;
        core->ahead_speeds = speeds;
        return 0;
    });
}

int core_taken(void* handle, const char* ids) {
    Core* core = static_cast<Core*>(handle);
    return guarded(core, [&] {
        for (auto& entry : core->all) entry.second->taken = false;
        for (Car* one : core->cars(ids)) one->taken = true;
        return 0;
    });
}

// The vehicles whose speeds are recorded after every step.
int core_watch(void* handle, const char* ids) {
    Core* core = static_cast<Core*>(handle);
    return guarded(core, [&] {
        core->watched = core->cars(ids);
        return 0;
    });
}

int core_advance(void* handle, int64_t step, int64_t decisions, int most, int decided, int driving, int judging) {
    Core* core = static_cast<Core*>(handle);
    return guarded(core, [&] {
        core->decisions = decisions;
        return core->advance(step, most, decided, driving, judging);
    });
}

// What the last call of core_advance recorded, as addresses and lengths.
struct Records {
    int64_t steps, decisions, lists;
    const double *times, *blocks, *sizes, *observations, *poses, *states;
    const int32_t *counts, *near_counts, *versions, *near_versions, *near_rows, *rows;
    const uint8_t* valid;
    int64_t block_length, size_length, observation_length, pose_length, state_length, near_length;
    const double* speeds;
    int64_t speed_length;
};

void core_records(void* handle, Records* to) {
    const Core& c = *static_cast<Core*>(handle);
    *to = {c.steps, c.decisions, static_cast<int64_t>(c.lists.size()), c.times.data(), c.blocks.data(), c.sizes.data(), c.observations.data(), c.poses.data(), c.states.data(),
           c.counts.data(), c.near_counts.data(), c.versions.data(), c.near_versions.data(), c.near_rows.data(),
           c.rows.data(), c.valids.data(), static_cast<int64_t>(c.blocks.size()),
           static_cast<int64_t>(c.sizes.size()), static_cast<int64_t>(c.observations.size()),
           static_cast<int64_t>(c.poses.size()), static_cast<int64_t>(c.states.size()),
           static_cast<int64_t>(c.near_rows.size()), c.speeds.data(), static_cast<int64_t>(c.speeds.size())};
}

const char* core_list(void* handle, int64_t which) { return static_cast<Core*>(handle)->lists[which].c_str(); }

// The lanes of the vehicles near after the last step, one per line: "" for one that is on none.
const char* core_lanes(void* handle) {
    Core& c = *static_cast<Core*>(handle);
    c.text.clear();
    for (const std::string& lane : c.lanes) c.text += lane + '\n';
    return c.text.c_str();
}

}  // extern "C"
