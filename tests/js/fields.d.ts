// Fields that classes of web/ set all at once with Object.assign, which TypeScript does not follow. For `make web-check`.

declare module "../../web/app.js" {
  interface App {
    hand: any; live: any; player: any; scene: any; stage: any;
  }
}

declare module "../../web/client.js" {
  interface Client {
    WebSocket: any; _fetch: any; base: any; key: any; storage: any;
  }
}

declare module "../../web/client/problem.js" {
  interface Problem {
    retryAfterS: any; status: any;
  }
}

declare module "../../web/client/push.js" {
  interface Push {
    client: any; onFrame: any; onProblem: any; onRest: any; spectrumId: any;
  }
}

declare module "../../web/draw/copies.js" {
  interface Copies {
    one: any; other: any; places: any;
  }
}

declare module "../../web/draw/splat.js" {
  interface SplatView {
    box: any; field: any; harmonics: any; mesh: any; renderer: any; ride: any; stage: any; textures: any;
    uniforms: any; values: any;
  }
}

declare module "../../web/draw/tree.js" {
  interface Tree {
    boneMotion: any; group: any; q: any; stage: any; surface: any; turn: any; voxelField: any;
  }
}

declare module "../../web/motion/local.js" {
  interface LocalPush {
    damping: any; modes: any; onFrame: any; onRest: any;
  }
}

declare module "../../web/motion/modes.js" {
  interface Modes {
    B: any; K: any; V: any; bone_joint_m: any; bone_lever_m2: any; bone_of_voxel: any; bone_parent: any;
    bone_reach_m: any; bone_shapes: any; coords: any; frames: any; frequencies_hz: any; lean_m: any; scale_m: any;
    shapes: any;
  }
}

declare module "../../web/motion/pin.js" {
  interface Pin {
    grip: any; modes: any; released: any; voxel: any;
  }
}

declare module "../../web/page/company.js" {
  interface CompanyPanel {
    onProblem: any; otherMotion: any; player: any; stage: any;
  }
}

declare module "../../web/page/doubt.js" {
  interface SizeDoubt {
    onChange: any; onHeight: any;
  }
}

declare module "../../web/page/files.js" {
  interface Files {
    client: any; formats: any; onProblem: any;
  }
}

declare module "../../web/page/hand.js" {
  interface Hand {
    onGrab: any; onProblem: any; source: any; stage: any;
  }
}

declare module "../../web/page/immersion.js" {
  interface Immersion {
    client: any; kits: any; name: any;
  }
}

declare module "../../web/page/jobs.js" {
  interface JobList {
    client: any; onDeleted: any; onOpen: any; onProblem: any;
  }
}

declare module "../../web/page/kits.js" {
  interface KitDialog {
    client: any; onMade: any; onProblem: any; tree: any;
  }
}

declare module "../../web/page/live.js" {
  interface LiveTree {
    files: any; onMotion: any; scene: any;
  }
}

declare module "../../web/page/player.js" {
  interface Player {
    made: any; otherSpeed: any; period: any; sinceShown: any;
  }
}

declare module "../../web/page/pull.js" {
  interface Pull {
    hand: any;
  }
}

declare module "../../web/page/record.js" {
  interface Encoder {
    frames: any; height: any; width: any;
  }
  interface Recorder {
    player: any; stage: any;
  }
}

declare module "../../web/page/scene.js" {
  interface Scene {
    client: any; onClear: any; onComplete: any; onDraft: any; onMotion: any; person: any;
  }
}

declare module "../../web/page/session.js" {
  interface Session {
    client: any; machine: any; onJob: any; onKey: any; scene: any;
  }
}

declare module "../../web/page/share.js" {
  interface ShareDialog {
    client: any; tree: any;
  }
}

declare module "../../web/page/strokes.js" {
  interface Marking {
    photos: any; picture: any; strokes: any;
  }
}

declare module "../../web/page/tree_form.js" {
  interface TreeForm {
    onApply: any; person: any; stage: any; tree: any;
  }
}

declare module "../../web/page/views.js" {
  interface ViewPanel {
    player: any; stage: any;
  }
}

declare module "../../web/page/wind.js" {
  interface WindPanel {
    onEndless: any; player: any; stage: any;
  }
}

export {};
