// Fields that classes of web/ set all at once with Object.assign, which TypeScript does not follow. For `make web-check`.

import type { Client } from "../../web/client.js";
import type { Hand } from "../../web/page/hand.js";
import type { KitDialog } from "../../web/page/kits.js";
import type { LiveTree } from "../../web/page/live.js";
import type { Modes } from "../../web/motion/modes.js";
import type { Person } from "../../web/draw/person.js";
import type { Player } from "../../web/page/player.js";
import type { Scene } from "../../web/page/scene.js";
import type { Stage } from "../../web/draw/stage.js";
import type { Tree } from "../../web/draw/tree.js";

declare module "../../web/app.js" {
  interface App {
    hand: Hand; live: LiveTree; player: Player; scene: Scene; stage: Stage;
  }
}

declare module "../../web/client.js" {
  interface Client {
    WebSocket: any; _fetch: any; base: string; key: string | null; storage: Storage | null;
  }
}

declare module "../../web/client/problem.js" {
  interface Problem {
    retryAfterS: number | null; status: number;
  }
}

declare module "../../web/client/push.js" {
  interface Push {
    client: Client; onFrame: Function; onProblem: Function; onRest: Function; spectrumId: string;
  }
}

declare module "../../web/draw/copies.js" {
  interface Copies {
    one: any; places: any;
  }
}

declare module "../../web/draw/splat.js" {
  interface SplatView {
    box: any; harmonics: any; mesh: any; renderer: any; splat: any; stage: Stage; textures: any; uniforms: any;
    values: any;
  }
}

declare module "../../web/draw/tree.js" {
  interface Tree {
    air: any; group: any; jointMotion: Float32Array; q: Float32Array; stage: Stage; surface: any; turn: number;
  }
}

declare module "../../web/motion/local.js" {
  interface LocalPush {
    damping: number; tree: Tree; onFrame: Function; onRest: Function;
  }
}

declare module "../../web/motion/modes.js" {
  interface Modes {
    J: number; K: number; V: number; bone_of_voxel: Int32Array; coords: Int16Array; frequencies_hz: Float32Array;
    joint_give: Float32Array; joint_of_bone: Int32Array; joint_parent: Int32Array; joint_place_m: Float32Array;
  }
}

declare module "../../web/motion/pin.js" {
  interface Pin {
    grip: any; modes: Modes; released: any; voxel: number;
  }
}

declare module "../../web/page/company.js" {
  interface CompanyPanel {
    player: Player; stage: Stage;
  }
}

declare module "../../web/page/doubt.js" {
  interface SizeDoubt {
    onChange: Function; onHeight: Function;
  }
}

declare module "../../web/page/files.js" {
  interface Files {
    client: Client; onDoubts: Function; onProblem: Function;
    products: () => Promise<{ format: string, file_name: string }[]>;
  }
}

declare module "../../web/page/hand.js" {
  interface Hand {
    onGrab: Function; onProblem: Function; source: any; stage: Stage;
  }
}

declare module "../../web/page/immersion.js" {
  interface Immersion {
    client: Client; kits: KitDialog; name: () => string;
  }
}

declare module "../../web/page/jobs.js" {
  interface JobList {
    client: Client; onDeleted: Function; onOpen: Function; onProblem: Function;
  }
}

declare module "../../web/page/kits.js" {
  interface KitDialog {
    client: Client; onMade: Function; onProblem: Function; tree: any;
  }
}

declare module "../../web/page/live.js" {
  interface LiveTree {
    files: any; onMotion: Function; scene: Scene;
  }
}

declare module "../../web/page/player.js" {
  interface Player {
    made: any; otherSpeed: number; period: number; sinceShown: number;
  }
}

declare module "../../web/page/pull.js" {
  interface Pull {
    hand: Hand;
  }
}

declare module "../../web/page/record.js" {
  interface Encoder {
    frames: any; height: number; width: number;
  }
  interface Recorder {
    player: Player; stage: Stage;
  }
}

declare module "../../web/page/scene.js" {
  interface Scene {
    client: Client; onClear: Function; onComplete: Function; onDraft: Function; onMotion: Function; person: Person;
  }
}

declare module "../../web/page/session.js" {
  interface Session {
    client: Client; machine: any; onJob: Function; onKey: Function; scene: Scene;
  }
}

declare module "../../web/page/share.js" {
  interface ShareDialog {
    client: Client; tree: any;
  }
}

declare module "../../web/page/strokes.js" {
  interface Marking {
    photos: any; picture: any; strokes: any;
  }
}

declare module "../../web/page/tree_form.js" {
  interface TreeForm {
    onApply: Function; person: Person; stage: Stage; tree: any;
  }
}

declare module "../../web/page/views.js" {
  interface ViewPanel {
    player: Player; stage: Stage;
  }
}

declare module "../../web/page/wind.js" {
  interface WindPanel {
    onEndless: Function; player: Player; stage: Stage;
  }
}

export {};
