"""A filter of any policy's actions after RSS: a safe distance along the road, no move into an occupied place across it.

RSS (Shalev-Shwartz et al. 2017) asks for the distance at which a vehicle can still stop behind one that brakes at its
hardest. Here the response time is that of the loop: an action changes the acceleration of the next step and the speed
of the one after it. Until then the present acceleration goes on, so RSS's a_max is what the vehicle really does.

Across the road the filter steers itself where the policy may not: back to the centre of the vehicle's lane, until the
vehicle drives straight on. So a vehicle that may not move over keeps its place and merges later (docs/decisions/059).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from cosim.loop.limits import Limits
from cosim.loop.near_vehicles import NearVehicles
from cosim.spec.scenario import RssFilter
from cosim.world.groups import MergeLanes

SIDE_MARGIN = 0.1  # [m]; vehicles less apart across the road count as in each other's path
LOOK_AHEAD = 1.0  # [s] in which a vehicle that moves over counts as in the path
BESIDE = 1.0  # [m] along the road before and behind a vehicle in which its place is occupied
COMFORTABLE = 4.0  # [m/s²] at most for a vehicle that is not in the path yet, and of a vehicle behind
BEHIND_RESPONSE = 0.5  # [s] of a vehicle behind
MOVING = 0.05  # [m/s] across the road
STRAIGHT = 0.2  # [m/s] across the road, below which a vehicle drives straight on
TOO_CLOSE = 0.4  # [m] across the road, kept where a vehicle has no lane to return to
LANE_CHANGE = 20.0  # [m] before the end of a lane, where a waiting vehicle stops: a slow one needs them to move over
YIELDING = 2.0  # [m/s²] at most, to let somebody in and to fall behind
SLOW, PULLING = 5.0, 1.5  # [m/s], [m/s²]: a slower vehicle that others wait for gets faster
USUAL = 15.0  # [m/s], by which a slow vehicle reckons when its lane ends: it will be faster
HESITANT = 0.3  # [m/s] towards the target lane, below which a policy does not merge


@dataclass
class SafetyFilter:
    """The filter with its parameters; `dt` [s] is the step of the loop, `lanes` are those of a merge.

    `steering` is where the filter steers at present: a lateral position d [m], NaN where the policy steers.
    `hesitated` [s] is for how long vehicle 0 could have moved over and did not.
    """

    rss: RssFilter
    dt: float
    lanes: MergeLanes | None = None
    steering: Float[np.ndarray, "G N"] | None = None
    hesitated: Float[np.ndarray, " G"] | None = None

    def limits(self, near: NearVehicles, planned_across: Float[np.ndarray, "G N"]) -> Limits:
        """The greatest accelerations, and where the filter steers.

        `planned_across` [m/s] is the lateral speed to the left that the policy wants.
        """
        limit = self.greatest_acceleration(near)
        occupied = self._occupied(near, limit)
        self.steering = self._steering(near, planned_across, occupied)
        along = self._along(near, limit)
        least = np.full(along.shape, -np.inf)
        if self.lanes is not None and self.rss.merge_within:
            yielding = self._yielding(near, planned_across, limit, occupied)
            along = np.minimum(np.minimum(along, yielding), self._before_lane_end(near, planned_across))
            # Nobody ahead is in the way, and vehicle 1 waits; at a standstill vehicle 0 cannot move over.
            waited_for = self._moves_over(near, planned_across) & np.isinf(yielding[:, 0])
            least[:, 0] = np.where(waited_for & self._ends_soon(near) & (near.pose.v[:, 0] < SLOW), PULLING, -np.inf)
        return Limits(along, self.steering, least, self._greatest_headings(near))

    def _greatest_headings(self, near: NearVehicles) -> tuple[Float[np.ndarray, "G N"], Float[np.ndarray, "G N"]]:
        """The headings [rad] to the left and right at which the rear of a vehicle does not swing into one beside it.

        A vehicle turns about its front, so its rear swings to the other side, the farther the slower it drives. Who
        will be beside it soon counts as well.
        """
        coming = (near.v - near.pose.v[..., None]) * LOOK_AHEAD
        beside = near.gap_ahead < BESIDE + np.maximum(-coming, 0.0)
        beside &= near.gap_behind < BESIDE + np.maximum(coming, 0.0)
        beside &= near.other & (near.side_gap >= 0)
        found = []
        for side in (-1.0, 1.0):  # a turn to the left needs room on the right
            room = np.where(beside & (near.direction == side), near.side_gap, np.inf).min(-1) - SIDE_MARGIN
            found.append(np.arcsin(np.clip(room / near.length, 0.0, 1.0)))
        return found[0], found[1]

    def _along(self, near: NearVehicles, limit: Float[np.ndarray, "G N V"]) -> Float[np.ndarray, "G N"]:
        """The greatest acceleration behind everybody who is in the path, or will be soon."""
        side = near.side_gap
        closing = near.direction * (near.across[..., None] - near.across_of)
        in_path = side < SIDE_MARGIN
        entering = ~in_path & (closing > MOVING) & (side < closing * LOOK_AHEAD) & (near.gap_ahead > 0)
        milder = np.where(in_path, limit, np.maximum(limit, -COMFORTABLE))
        return np.where(near.ahead & (in_path | entering), milder, np.inf).min(-1)

    def greatest_acceleration(self, near: NearVehicles) -> Float[np.ndarray, "G N V"]:
        """The acceleration [m/s²] of the next step after which the vehicle can still stop behind each vehicle ahead."""
        room = near.gap_ahead - self.rss.margin + near.v**2 / (2 * self.rss.other_braking)
        v, a = near.pose.v[..., None], near.pose.a[..., None]
        return self._to_stop_within(room, v, a, self.rss.braking)

    def _to_stop_within(self, room: np.ndarray, v: np.ndarray, a: np.ndarray, b: float) -> np.ndarray:
        """The acceleration [m/s²] of the next step after which the vehicle can stop in `room` [m] by braking with b.

        With speed v and acceleration a, v₁ = v + a·Δt is the speed of the next step whatever is decided. The speed v₂
        after it must fulfil v·Δt + v₁·Δt + v₂·Δt/2 + v₂²/(2b) ≤ room.
        """
        dt, v_1 = self.dt, np.maximum(v + a * self.dt, 0.0)
        left = np.maximum(room - (v + v_1) * dt, 0.0)
        v_2 = b * (np.sqrt(dt**2 / 4 + 2 * left / b) - dt / 2)
        return np.maximum((v_2 - v_1) / dt, -b)

    def _yielding(
        self,
        near: NearVehicles,
        planned_across: Float[np.ndarray, "G N"],
        limit: Float[np.ndarray, "G N V"],
        occupied: Bool[np.ndarray, "G N V"],
    ) -> Float[np.ndarray, "G N"]:
        """The greatest acceleration with which a merge gets room: vehicle 0 falls behind, and vehicle 1 lets it in.

        As soon as vehicle 0 is to move over, it yields to who occupies the place and is farther ahead, and to the
        leader as long as that is beside it. Vehicle 1 keeps the distance to it that it needs once vehicle 0 is in its
        lane. Both brake with YIELDING at most.
        """
        assert self.lanes is not None
        found = np.full(planned_across.shape, np.inf)
        moves_over = self._moves_over(near, planned_across)
        if moves_over.any():
            milder = np.maximum(limit, -YIELDING)
            ahead = near.s > (near.pose.s - 0.5 * near.length)[:, :1]
            leader = np.arange(near.s.shape[-1]) == near.row[:, 2:3]  # has the way as long as it is not passed
            ahead |= leader & (near.s > (near.pose.s - near.length)[:, :1])
            found[:, 0] = np.where(occupied[:, 0] & self._in_target(near) & ahead, milder[:, 0], np.inf).min(-1)
            merging = np.take_along_axis(milder[:, 1], near.row[:, :1], -1)[:, 0]
            behind = near.pose.s[:, 1] < near.pose.s[:, 0]
            found[:, 1] = np.where(behind, merging, np.inf)
            found[~moves_over] = np.inf
        return found

    def _moves_over(self, near: NearVehicles, planned_across: Float[np.ndarray, "G N"]) -> Bool[np.ndarray, " G"]:
        """Whether vehicle 0 is on the lane that ends, and is to leave it: by its policy, by the filter, or soon."""
        assert self.lanes is not None
        assert self.steering is not None
        towards = self.lanes.side * np.maximum(planned_across[:, 0], near.across[:, 0])
        wants = (towards > MOVING) | ~np.isnan(self.steering[:, 0]) | self._ends_soon(near)
        return self._on_source(near) & wants

    def _ends_soon(self, near: NearVehicles) -> Bool[np.ndarray, " G"]:
        assert self.lanes is not None
        left = self.lanes.source.end - near.pose.s[:, 0]
        return self._on_source(near) & (left < np.maximum(near.pose.v[:, 0], USUAL) * self.rss.merge_within)

    def _in_target(self, near: NearVehicles) -> Bool[np.ndarray, "G V"]:
        """Who would be in the path of vehicle 0 in the target lane."""
        assert self.lanes is not None
        return np.abs(near.d - self.lanes.target.centre) < 0.5 * (near.width[:, :1] + near.width_of) + SIDE_MARGIN

    def _before_lane_end(
        self, near: NearVehicles, planned_across: Float[np.ndarray, "G N"]
    ) -> Float[np.ndarray, "G N"]:
        """The greatest acceleration with which vehicle 0 can stop comfortably before the end of its lane.

        One that waits stops where there is still room to move over.
        """
        assert self.lanes is not None
        assert self.steering is not None
        found = np.full(near.pose.s.shape, np.inf)
        if self.lanes.ends:
            steering, target = self.steering[:, 0], self.lanes.target.centre
            crosses = np.where(
                np.isnan(steering), self.lanes.side * planned_across[:, 0] > HESITANT, steering == target
            )
            room = self.lanes.source.end - np.where(crosses, self.rss.margin, LANE_CHANGE) - near.pose.s[:, 0]
            limit = self._to_stop_within(np.maximum(room, 0.0), near.pose.v[:, 0], near.pose.a[:, 0], COMFORTABLE)
            found[:, 0] = np.where(self._on_source(near), limit, np.inf)
        return found

    def _on_source(self, near: NearVehicles) -> Bool[np.ndarray, " G"]:
        """Whether the centre of vehicle 0 is on the lane that ends, beside the target lane."""
        assert self.lanes is not None
        s, d = near.pose.s[:, 0], near.pose.d[:, 0]
        begin = max(self.lanes.source.begin, self.lanes.target.begin)
        return np.asarray((s >= begin) & (s <= self.lanes.source.end) & (self.lanes.beyond(d) < 0))

    def _steering(
        self, near: NearVehicles, planned_across: Float[np.ndarray, "G N"], occupied: Bool[np.ndarray, "G N V"]
    ) -> Float[np.ndarray, "G N"]:
        """Where the filter steers: NaN where the policy may steer."""
        d, across = near.pose.d, near.across
        last = np.full(d.shape, np.nan) if self.steering is None else self.steering
        home = self._home(near)
        wanted = np.where(np.isnan(last), planned_across, across)
        stopped = self._blocked(near, wanted, occupied) | self._blocked(near, across, occupied)
        stopped |= self._leaves_road(near, wanted)
        merging = self._merges(near, planned_across, occupied, last)
        steering = np.where(stopped, home, np.where(merging, self._target(near), last))
        towards = np.sign(steering - d) * np.where(np.abs(steering - d) > TOO_CLOSE, 2 * MOVING, 0.0)
        no_way = self._blocked(near, np.nan_to_num(towards), occupied)
        steering = np.where(no_way, d, steering)
        arrived = ~stopped & ~merging & (np.abs(across) < STRAIGHT)
        return np.where(arrived, np.nan, steering)

    def _blocked(
        self, near: NearVehicles, speed: Float[np.ndarray, "G N"], occupied: Bool[np.ndarray, "G N V"]
    ) -> Bool[np.ndarray, "G N"]:
        """Whether lateral motion to the left at a `speed` [m/s] leads to an occupied place."""
        side, towards = near.side_gap, near.direction * speed[..., None]
        reach = self.rss.margin_across + np.maximum(towards, 0) * LOOK_AHEAD
        return np.asarray((occupied & (towards > MOVING) & (side >= 0) & (side < reach)).any(-1))

    def _occupied(self, near: NearVehicles, limit: Float[np.ndarray, "G N V"]) -> Bool[np.ndarray, "G N V"]:
        """Whether the place beside the vehicle belongs to another one: beside it, or too close ahead or behind."""
        v = near.pose.v[..., None]
        beside = (near.gap_ahead < BESIDE) & (near.gap_behind < BESIDE)
        too_close_ahead = near.ahead & (limit < -COMFORTABLE)
        needed = near.v * BEHIND_RESPONSE + np.maximum(near.v**2 - v**2, 0.0) / (2 * COMFORTABLE) + self.rss.margin
        too_close_behind = ~near.ahead & (near.gap_behind < needed)
        return near.other & (beside | too_close_ahead | too_close_behind)

    def _home(self, near: NearVehicles) -> Float[np.ndarray, "G N"]:
        """The centre of the lane to which a vehicle returns; without lanes, where it is, away from who is too close."""
        if self.lanes is not None:
            home = np.full(near.pose.d.shape, self.lanes.target.centre)
            home[:, 0] = np.where(self._on_source(near), self.lanes.source.centre, home[:, 0])
            return home
        beside = near.other & (near.side_gap >= 0) & (near.gap_ahead < BESIDE) & (near.gap_behind < BESIDE)
        side = np.where(beside, near.side_gap, np.inf)
        direction = np.take_along_axis(near.direction, side.argmin(-1)[..., None], -1)[..., 0]
        return near.pose.d - direction * np.maximum(TOO_CLOSE - side.min(-1), 0.0)

    def _target(self, near: NearVehicles) -> Float[np.ndarray, "G N"]:
        centre = np.nan if self.lanes is None else self.lanes.target.centre
        return np.full(near.pose.d.shape, centre)

    def _leaves_road(self, near: NearVehicles, speed: Float[np.ndarray, "G N"]) -> Bool[np.ndarray, "G N"]:
        """Whether a vehicle would leave the two lanes of a merge sideways, at a `speed` [m/s] to the left."""
        if self.lanes is None:
            return np.zeros(speed.shape, dtype=bool)
        lanes, room = self.lanes, 0.5 * self.lanes.target.width
        later = near.pose.d + speed * LOOK_AHEAD
        beyond, inner = lanes.side * (later - lanes.target.centre), np.full(speed.shape, room)
        inner[:, 0] += np.where(near.pose.s[:, 0] <= lanes.source.end, lanes.source.width, 0.0)
        half = 0.5 * near.width
        beyond_target = (beyond + half > room) & (lanes.side * speed > MOVING)
        return np.asarray(beyond_target | ((beyond - half < -inner) & (lanes.side * speed < -MOVING)))

    def _merges(
        self,
        near: NearVehicles,
        planned_across: Float[np.ndarray, "G N"],
        occupied: Bool[np.ndarray, "G N V"],
        last: Float[np.ndarray, "G N"],
    ) -> Bool[np.ndarray, "G N"]:
        """Whether the filter itself moves vehicle 0 over: its lane ends soon, there is room, and its policy hesitates.

        Once begun, the filter goes on until the vehicle is inside the target lane.
        """
        found = np.zeros(planned_across.shape, dtype=bool)
        if self.lanes is None or not self.lanes.ends or not self.rss.merge_within:
            return found
        lanes, missing = self.lanes, self.lanes.target.centre - near.pose.d[:, 0]
        hesitates = lanes.side * planned_across[:, 0] < HESITANT
        room = ~(occupied[:, 0] & self._in_target(near)).any(-1)
        begun = (last[:, 0] == lanes.target.centre) & (lanes.side * missing > STRAIGHT)
        hesitated = np.zeros(len(found)) if self.hesitated is None else self.hesitated
        self.hesitated = np.where(hesitates, hesitated + np.where(room, self.dt, 0.0), 0.0)
        found[:, 0] = (self._ends_soon(near) & hesitates & room & (self.hesitated > self.rss.patience)) | begun
        return found
